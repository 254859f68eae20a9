"""What runs, as pages show it and as `/api/live` tells it: the same words in both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass

from results.entries import Counts, RunEntry
from results.live import STALE_S, LiveSimulator
from results.report.text import NOTHING, count, percent, span

SILENT = "silent"
"""State of a run whose status is "running" and that has said nothing for `STALE_S`."""


@dataclass(frozen=True)
class SimulatorView:
    """How far the episodes of one simulator are."""

    simulator: str
    planned: int
    done: int
    successes: int
    failures: int
    errors: int
    shares: tuple[float, float, float]
    """Successes, failures and errors of what is planned (percent)."""
    rate: str
    """Success so far, with its interval, in words."""
    per_minute: str
    left: str
    progress: str
    """All of it in a sentence, for a screen reader."""


@dataclass(frozen=True)
class WorkerView:
    """What one worker does."""

    worker: str
    simulator: str
    doing: str
    since: str
    """For how long, in words."""


@dataclass(frozen=True)
class LiveView:
    """A suite that runs, or was running when it was last heard of."""

    id: str
    name: str
    suite: str
    state: str
    """Its status, or `SILENT`."""
    said: str
    """The state in words: "running", "silent for 7 min"."""
    phase: str
    done: int
    planned: int
    errors: int
    rate: str
    simulators: tuple[SimulatorView, ...]
    workers: tuple[WorkerView, ...]
    says: tuple[str, ...]


def state_of(entry: RunEntry, now: float) -> str:
    """Its status; `SILENT` where it says that it runs and has said nothing for a minute."""
    return SILENT if entry.status == "running" and now - _heard(entry) > STALE_S else entry.status


def said_of(entry: RunEntry, now: float) -> str:
    """The state in words."""
    state = state_of(entry, now)
    return f"silent for {minutes(now - _heard(entry))}" if state == SILENT else state


def counts_of(entry: RunEntry) -> Counts:
    """What came of a run so far: while it runs, by what it says of itself."""
    if entry.status != "running" or entry.live is None or not entry.live.simulators:
        return entry.counts
    return sum((_counts(one) for one in entry.live.simulators), Counts())


def live_view(entry: RunEntry, now: float) -> LiveView:
    """What is shown of a run that runs.

    Args:
        entry: The run.
        now: Seconds since 1970, UTC.
    """
    counts, live = counts_of(entry), entry.live
    silent = state_of(entry, now) == SILENT
    return LiveView(
        id=entry.run_id,
        name=entry.name,
        suite=entry.suite,
        state=state_of(entry, now),
        said=said_of(entry, now),
        phase="" if live is None or silent else live.phase,
        done=counts.done,
        planned=counts.planned,
        errors=counts.errors,
        rate=_rate(counts),
        simulators=() if live is None else tuple(_simulator(one, silent) for one in live.simulators),
        workers=()
        if live is None or silent
        else tuple(WorkerView(w.worker, w.simulator, w.doing, brief(now - w.since)) for w in live.workers),
        says=() if live is None else live.says[-5:],
    )


def shape_of(views: Sequence[LiveView]) -> str:
    """Changes when parts appear or go, not when their numbers change: then a page is to be drawn anew."""
    parts = [
        (view.id, view.state, [s.simulator for s in view.simulators], [w.worker for w in view.workers], len(view.says))
        for view in views
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def brief(value: float) -> str:
    """A time in whole seconds or minutes, which does not flicker: `12 s`, `7 min`, `2 h 5 min`."""
    value = max(value, 0.0)
    return f"{value:.0f} s" if value < 60 else minutes(value)


def minutes(value: float) -> str:
    """A time in whole minutes, hours or days."""
    whole = int(value // 60)
    if whole >= 48 * 60:
        return f"{whole // 1440:,} days"
    return f"{whole} min" if whole < 60 else f"{whole // 60} h {whole % 60} min"


def _heard(entry: RunEntry) -> float:
    """When a run last said something, or began (seconds since 1970, UTC)."""
    return entry.started_at if entry.live is None else max(entry.live.at, entry.started_at)


def _counts(one: LiveSimulator) -> Counts:
    return Counts(one.planned, one.successes, one.failures, one.errors)


def _rate(counts: Counts) -> str:
    return "no verdict yet" if counts.rate is None else f"{percent(counts.rate)} {span(counts.interval)}"


def _simulator(one: LiveSimulator, silent: bool) -> SimulatorView:
    """How fast a run was and what is left is nothing that a silent one can be held to."""
    pace, left_s = (None, None) if silent else (one.per_minute, one.left_s)
    counts = _counts(one)
    whole = max(one.planned, one.done, 1)
    rate, left = _rate(counts), NOTHING if left_s is None else brief(left_s)
    progress = f"{count(one.done)} of {count(one.planned)} episodes, success {rate}, {count(one.errors)} errors"
    return SimulatorView(
        simulator=one.simulator,
        planned=one.planned,
        done=one.done,
        successes=one.successes,
        failures=one.failures,
        errors=one.errors,
        shares=(
            round(100 * one.successes / whole, 2),
            round(100 * one.failures / whole, 2),
            round(100 * one.errors / whole, 2),
        ),
        rate=rate,
        per_minute=NOTHING if pace is None else f"{pace:,.3g}",
        left=left,
        progress=progress + ("" if left_s is None else f", {left} left"),
    )
