"""The processes of a command and all that it started, also those that have other parents now."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator

import psutil

MARK = "ROBOGAUNTLET_CHAOS"
"""Environment variable that all processes of a command inherit."""
RAY_PARTS = ("raylet", "gcs_server")


def marked(mark: str) -> list[psutil.Process]:
    """Running processes with this mark, without zombies."""
    return [process for process in psutil.process_iter() if _is(process, mark)]


def processes_by_kind(mark: str) -> dict[str, list[psutil.Process]]:
    """The processes with this mark by kind, see `by_kind`."""
    return by_kind(marked(mark))


def by_kind(processes: Iterable[psutil.Process]) -> dict[str, list[psutil.Process]]:
    """These processes by kind: raylet, gcs_server, worker, and playing (workers with a lease)."""
    kinds: dict[str, list[psutil.Process]] = {name: [] for name in (*RAY_PARTS, "worker", "playing")}
    for process in processes:
        with contextlib.suppress(psutil.Error):
            title = process.cmdline()[:1]
            if process.name() in RAY_PARTS:
                kinds[process.name()].append(process)
            elif title and title[0].startswith("ray::Worker"):
                kinds["worker"].append(process)
                if title[0] == "ray::Worker.play":
                    kinds["playing"].append(process)
    return kinds


def remaining_after(mark: str, seconds: float) -> list[str]:
    """Names of processes with this mark that still run after this time (s); returns as soon as there are none."""
    return names_after(seconds, lambda: marked(mark))


def names_after(seconds: float, find: Callable[[], list[psutil.Process]]) -> list[str]:
    """Names of processes that are still found after this time (s); returns as soon as there are none."""
    deadline = time.monotonic() + seconds
    while (left := find()) and time.monotonic() < deadline:
        time.sleep(0.2)
    return list(_names(left))


def end(mark: str) -> None:
    """Kill all processes with this mark."""
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
