"""One run of a suite under random faults, which is resumed whenever it ends early."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunStatus, read_run, store_url
from robogauntlet.results.store.episode_store import Store
from tests.chaos.processes import MARK, end, processes_by_kind, remaining_after

START_S = 120.0
"""Time for a run to start its first episode, or to end (s)."""
END_S = 300.0
"""Time for a run to end after the last fault (s)."""
GONE_S = 60.0
"""Time for all processes to end (s). A worker whose raylet is killed while it starts searches for it for 26 s (measured
with Ray 2.60) before it ends."""
MAX_STARTS = 20
LOCK_S = 3.0


@dataclass
class Command:
    """A running `robogauntlet run`."""

    process: subprocess.Popen[bytes]
    mark: str
    folder: Path


def _kill(kind: str, with_signal: int) -> Callable[[Command, random.Random], bool]:
    def fault(command: Command, generator: random.Random) -> bool:
        candidates = processes_by_kind(command.mark)[kind]
        if not candidates:
            return False
        with contextlib.suppress(psutil.NoSuchProcess):
            generator.choice(candidates).send_signal(with_signal)
        return True

    return fault


def _signal(with_signal: int) -> Callable[[Command, random.Random], bool]:
    def fault(command: Command, generator: random.Random) -> bool:
        command.process.send_signal(with_signal)
        return True

    return fault


def _lock_store(command: Command, generator: random.Random) -> bool:
    """Hold the store's write lock for a while, as another program that writes to it would."""
    file = command.folder / "episodes.sqlite"
    if not file.exists():
        return False
    with contextlib.closing(sqlite3.connect(file, timeout=30.0, isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        time.sleep(LOCK_S)
        connection.execute("ROLLBACK")
    return True


FAULTS: dict[str, Callable[[Command, random.Random], bool]] = {
    "worker killed": _kill("worker", signal.SIGKILL),
    "worker hung": _kill("playing", signal.SIGSTOP),
    "raylet killed": _kill("raylet", signal.SIGKILL),
    "Ray head killed": _kill("gcs_server", signal.SIGKILL),
    "scheduler killed": _signal(signal.SIGKILL),
    "scheduler terminated": _signal(signal.SIGTERM),
    "interrupted": _signal(signal.SIGINT),
    "store locked": _lock_store,
}
"""Name to a function that causes the fault and returns whether it could."""


@dataclass(frozen=True)
class CampaignResult:
    """The result of a run under faults."""

    faults: Sequence[str]
    """The faults that occurred, in order."""
    starts: int
    """Number of times that the command was started."""
    seconds: float
    rows_hash: str | None
    problems: Sequence[str] = field(default_factory=list)
    """A line for each violated expectation: lost or duplicate episodes, remaining processes, and so on."""


def draw_faults(seed: int, count: int) -> list[str]:
    """Draw faults for a campaign from shuffled decks of all kinds, so that each kind occurs equally often."""
    generator, faults = random.Random(seed), list[str]()
    while len(faults) < count:
        deck = sorted(FAULTS)
        generator.shuffle(deck)
        faults += deck
    return faults[:count]


def run_campaign(suite: Path, folder: Path, seed: int, *, faults: Sequence[str], gap_s: float) -> CampaignResult:
    """Run a suite, cause these faults one after the other, and resume the run until it is complete.

    Args:
        suite: The suite file.
        folder: The run folder, which must not exist.
        seed: Seed of the times between faults and of the choice among processes.
        faults: Names from `FAULTS`, in order.
        gap_s: Mean time between two faults, once episodes are played (s).
    """
    began, generator = time.monotonic(), random.Random(seed)
    mark, left, done, starts = uuid.uuid4().hex, list(faults), list[str](), 0
    problems: list[str] = []
    try:
        while starts < MAX_STARTS and not problems:
            starts += 1
            command = _start(suite, folder, mark)
            while left and command.process.poll() is None and _playing(command):
                time.sleep(generator.expovariate(1.0 / gap_s))
                if command.process.poll() is None and FAULTS[left[0]](command, generator):
                    done.append(left.pop(0))
            try:
                code = command.process.wait(END_S)
            except subprocess.TimeoutExpired:
                problems.append(f"start {starts} hangs after: {', '.join(done)}")
                break
            if remaining := remaining_after(mark, GONE_S):
                problems.append(f"processes remain after start {starts}: {', '.join(remaining)}")
            if code == 0:
                break
        else:
            problems.append(f"not complete after {starts} starts; see {_log(folder)}")
    finally:
        end(mark)
    problems += [f"this fault did not occur: {name}" for name in left]
    rows_hash = None
    if (folder / "run.json").exists():
        rows_hash = read_run(folder).rows_hash
        problems += _check(folder)
    return CampaignResult(done, starts, time.monotonic() - began, rows_hash, problems)


def _check(folder: Path) -> list[str]:
    document = read_run(folder)
    store = Store.open(store_url(folder, document, None), document.run_id)
    rows = list(store.results())
    store.close()
    distinct = len({row.episode_id for row in rows})
    errors = [row.error for row in rows if row.status == Status.ERROR]
    expectations = {
        f"expected a complete run, it is {document.status}": document.status is RunStatus.COMPLETE,
        f"expected {document.planned} rows, got {len(rows)}": len(rows) == document.planned,
        f"expected {len(rows)} different episodes, got {distinct}": distinct == len(rows),
        f"expected no errors, got {len(errors)}: {errors[:1]}": not errors,
    }
    return [line for line, holds in expectations.items() if not holds]


def _start(suite: Path, folder: Path, mark: str) -> Command:
    program = "import sys; from robogauntlet.orchestrator.cli import main; main()"
    arguments = [sys.executable, "-c", program, "run", str(suite), "--out", str(folder), "--no-media"]
    with _log(folder).open("ab") as log:
        process = subprocess.Popen(
            arguments, env={**os.environ, MARK: mark}, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )
    return Command(process, mark, folder)


def _playing(command: Command) -> bool:
    """Wait until episodes are played; False if the command ends before or takes too long."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and command.process.poll() is None:
        if processes_by_kind(command.mark)["playing"]:
            return True
        time.sleep(0.2)
    return False


def _log(folder: Path) -> Path:
    return folder.with_suffix(".log")
