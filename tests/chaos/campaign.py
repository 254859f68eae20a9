"""One run of a suite under random faults, which is resumed whenever it ends early."""

from __future__ import annotations

import random
import subprocess
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunStatus, read_run, store_url
from robogauntlet.results.store.episode_store import Store
from tests.chaos.places import Command, OneMachine
from tests.chaos.processes import by_kind

START_S = 120.0
"""Time for a run to start its first episode, or to end (s)."""
END_S = 300.0
"""Time for a run to end after the last fault (s)."""
MAX_STARTS = 20


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


def draw_faults(seed: int, count: int, kinds: Iterable[str] = OneMachine.faults) -> list[str]:
    """Draw faults for a campaign from shuffled decks of all kinds, so that each kind occurs equally often."""
    generator, faults = random.Random(seed), list[str]()
    while len(faults) < count:
        deck = sorted(kinds)
        generator.shuffle(deck)
        faults += deck
    return faults[:count]


def run_campaign(
    suite: Path, folder: Path, seed: int, *, faults: Sequence[str], gap_s: float, place: OneMachine | None = None
) -> CampaignResult:
    """Run a suite, cause these faults one after the other, and resume the run until it is complete.

    Args:
        suite: The suite file.
        folder: The run folder, which must not exist.
        seed: Seed of the times between faults and of the choice among processes.
        faults: Names from the faults of the place, in order.
        gap_s: Mean time between two faults, once episodes are played (s).
        place: Where it runs, by default on this machine.
    """
    began, generator = time.monotonic(), random.Random(seed)
    place, log = place or OneMachine(), folder.with_suffix(".log")
    left, done, starts = list(faults), list[str](), 0
    problems: list[str] = []
    try:
        while starts < MAX_STARTS and not problems:
            starts += 1
            command = place.start(suite, folder, log)
            while left and command.process.poll() is None and _playing(command):
                time.sleep(generator.expovariate(1.0 / gap_s))
                if command.process.poll() is None and place.faults[left[0]](command, generator):
                    done.append(left.pop(0))
            try:
                code = command.process.wait(END_S)
            except subprocess.TimeoutExpired:
                problems.append(f"start {starts} hangs after: {', '.join(done)}")
                break
            if remaining := place.remaining():
                problems.append(f"processes remain after start {starts}: {', '.join(remaining)}")
            if code == 0:
                break
        else:
            problems.append(f"not complete after {starts} starts; see {log}")
    except (AssertionError, OSError, subprocess.SubprocessError) as error:
        problems.append(f"the campaign itself failed at start {starts}: {error!r}")
    finally:
        problems += place.end()
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


def _playing(command: Command) -> bool:
    """Wait until episodes are played; False if the command ends before or takes too long."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and command.process.poll() is None:
        if by_kind(command.place.processes())["playing"]:
            return True
        time.sleep(0.2)
    return False
