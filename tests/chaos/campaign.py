"""One run of a suite under faults drawn at random, begun again whenever it ends early, and what came of it."""

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
from tests.chaos.processes import MARK, end, left_after, of_kind

START_S = 120.0
"""Time for a run to come to its first episode, or to its end."""
END_S = 300.0
"""Time for a run to end when nothing is done to it any more."""
GONE_S = 60.0
"""Time for all processes to be gone. A worker whose raylet is killed while it starts looks for it for 26 s (by hand,
Ray 2.60) and ends then."""
STARTS = 20
LOCK_S = 3.0


@dataclass
class Command:
    """A `robogauntlet run` that is under way."""

    process: subprocess.Popen[bytes]
    mark: str
    folder: Path


def _kill(kind: str, with_signal: int) -> Callable[[Command, random.Random], bool]:
    def act(command: Command, random_: random.Random) -> bool:
        candidates = of_kind(command.mark)[kind]
        if not candidates:
            return False
        with contextlib.suppress(psutil.NoSuchProcess):
            random_.choice(candidates).send_signal(with_signal)
        return True

    return act


def _signal(with_signal: int) -> Callable[[Command, random.Random], bool]:
    def act(command: Command, random_: random.Random) -> bool:
        command.process.send_signal(with_signal)
        return True

    return act


def _lock_store(command: Command, random_: random.Random) -> bool:
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
    "scheduler told to end": _signal(signal.SIGTERM),
    "interrupted": _signal(signal.SIGINT),
    "store locked": _lock_store,
}


@dataclass(frozen=True)
class Survived:
    """What came of a run under faults."""

    faults: Sequence[str]
    """What was done to it, in order."""
    starts: int
    """Times that the command was given."""
    seconds: float
    rows_hash: str | None
    problems: Sequence[str] = field(default_factory=list)
    """What was lost, doubled, left behind or otherwise not as it should be: a line each."""


def drawn_faults(seed: int, count: int) -> list[str]:
    """Faults for a campaign: shuffled decks of all kinds, so that each comes up as often as any other."""
    generator, faults = random.Random(seed), list[str]()
    while len(faults) < count:
        deck = sorted(FAULTS)
        generator.shuffle(deck)
        faults += deck
    return faults[:count]


def campaign(suite: Path, folder: Path, seed: int, *, faults: Sequence[str], gap_s: float) -> Survived:
    """Run a suite, do these things to it in turn, and give the command again until the run is complete.

    Args:
        suite: The suite's file.
        folder: The run's folder, new.
        seed: Of the times between faults and of the choice among processes.
        faults: Names from `FAULTS`, in order.
        gap_s: Mean time (s) between two faults, once episodes are played.
    """
    began, drawn = time.monotonic(), random.Random(seed)
    mark, left, done, starts = uuid.uuid4().hex, list(faults), [], 0
    problems: list[str] = []
    try:
        while starts < STARTS and not problems:
            starts += 1
            command = _start(suite, folder, mark)
            while left and command.process.poll() is None and _playing(command):
                time.sleep(drawn.expovariate(1.0 / gap_s))
                if command.process.poll() is None and FAULTS[left[0]](command, drawn):
                    done.append(left.pop(0))
            try:
                code = command.process.wait(END_S)
            except subprocess.TimeoutExpired:
                problems.append(f"start {starts} hangs after: {', '.join(done)}")
                break
            if survivors := left_after(mark, GONE_S):
                problems.append(f"left behind after start {starts}: {', '.join(survivors)}")
            if code == 0:
                break
        else:
            problems.append(f"not complete after {starts} starts; see {_log(folder)}")
    finally:
        end(mark)
    problems += [f"not done: {name}" for name in left]
    rows_hash = None
    if (folder / "run.json").exists():
        document = read_run(folder)
        rows_hash = document.rows_hash
        problems += _check(folder)
    return Survived(done, starts, time.monotonic() - began, rows_hash, problems)


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
    """Wait until episodes are played; whether that came about."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and command.process.poll() is None:
        if of_kind(command.mark)["playing"]:
            return True
        time.sleep(0.2)
    return False


def _log(folder: Path) -> Path:
    return folder.with_suffix(".log")
