"""The processes that belong to a command and everything that it started, whoever their parents are by now."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

import psutil

MARK = "ROBOGAUNTLET_CHAOS"
"""Environment variable that a command hands down to whatever it starts."""
RAY_PARTS = ("raylet", "gcs_server")


def marked(mark: str) -> list[psutil.Process]:
    """Living processes with this mark, those that have ended but were not waited for left out."""
    return [process for process in psutil.process_iter() if _is(process, mark)]


def of_kind(mark: str) -> dict[str, list[psutil.Process]]:
    """The processes with this mark that something can be done to: raylet, gcs_server, worker, and playing.

    A worker is one that has been given a simulator; playing are those workers that hold a lease.
    """
    found: dict[str, list[psutil.Process]] = {name: [] for name in (*RAY_PARTS, "worker", "playing")}
    for process in marked(mark):
        with contextlib.suppress(psutil.Error):
            title = process.cmdline()[:1]
            if process.name() in RAY_PARTS:
                found[process.name()].append(process)
            elif title and title[0].startswith("ray::Worker"):
                found["worker"].append(process)
                if title[0] == "ray::Worker.play":
                    found["playing"].append(process)
    return found


def left_after(mark: str, seconds: float) -> list[str]:
    """Names of processes with this mark that are still there after so long, none as soon as there are none."""
    deadline = time.monotonic() + seconds
    while (left := marked(mark)) and time.monotonic() < deadline:
        time.sleep(0.2)
    return list(_names(left))


def end(mark: str) -> None:
    """Kill whatever is left with this mark."""
    for process in marked(mark):
        with contextlib.suppress(psutil.Error):
            process.kill()


def _names(processes: list[psutil.Process]) -> Iterator[str]:
    for process in processes:
        with contextlib.suppress(psutil.Error):
            yield f"{process.name()} ({process.pid})"


def _is(process: psutil.Process, mark: str) -> bool:
    try:
        return process.environ().get(MARK) == mark and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False
