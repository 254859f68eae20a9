"""Running suites as pages and `/api/live` show them, with the same texts in both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from robogauntlet.results.live_status import STALE_S, LiveSimulator
from robogauntlet.results.report.formatting import NOTHING, count, percent, span
from robogauntlet.results.store.history_records import Counts, RunEntry
from robogauntlet.support.durations import format_duration

SILENT = "silent"
"""State of a run whose status is "running" but which has not reported for `STALE_S`."""


@dataclass(frozen=True)
class SimulatorView:
    """Progress of the episodes of one simulator."""

    simulator: str
    planned: int
    done: int
    successes: int
    failures: int
    errors: int
    shares: tuple[float, float, float]
    """Successes, failures and errors among the planned episodes (percent)."""
    rate: str
    """Success rate so far with its interval."""
    per_minute: str
    left: str
    progress: str
    """The progress as a sentence, for screen readers."""


@dataclass(frozen=True)
class WorkerView:
    """Activity of a worker."""

    worker: str
    simulator: str
    doing: str
    since: str
    """Duration of the activity."""


@dataclass(frozen=True)
class LiveView:
    """A suite that is running, or was when it last reported."""

    id: str
    name: str
    suite: str
    state: str
    """Status of the run, or `SILENT`."""
    state_text: str
    """The state as text: "running", "silent for 7 min"."""
    phase: str
    done: int
    planned: int
    errors: int
    rate: str
    simulators: tuple[SimulatorView, ...]
    workers: tuple[WorkerView, ...]
    messages: tuple[str, ...]


def state_of(entry: RunEntry, now: float) -> str:
    """Return the status of a run; `SILENT` if it is "running" but has not reported for `STALE_S`."""
    return SILENT if entry.status == "running" and now - _last_report_at(entry) > STALE_S else entry.status


def state_text_of(entry: RunEntry, now: float) -> str:
    """Return the state of a run as text."""
    state = state_of(entry, now)
    return f"silent for {brief(now - _last_report_at(entry))}" if state == SILENT else state


def counts_of(entry: RunEntry) -> Counts:
    """Return the counts of a run; while it is running, those of its live status."""
    if entry.status != "running" or entry.live is None or not entry.live.simulators:
        return entry.counts
    return sum(map(_counts, entry.live.simulators), Counts())


def live_view(entry: RunEntry, now: float) -> LiveView:
    """Return the view of a running suite.

    Args:
        entry: The run.
        now: The time (seconds since 1970, UTC).
    """
    counts, live = counts_of(entry), entry.live
    silent = state_of(entry, now) == SILENT
    return LiveView(
        id=entry.run_id,
        name=entry.name,
        suite=entry.suite,
        state=state_of(entry, now),
        state_text=state_text_of(entry, now),
        phase="" if live is None or silent else live.phase,
        done=counts.done,
        planned=counts.planned,
        errors=counts.errors,
        rate=_rate(counts),
        simulators=() if live is None else tuple(_simulator(simulator, silent) for simulator in live.simulators),
        workers=()
        if live is None or silent
        else tuple(WorkerView(w.worker, w.simulator, w.activity, brief(now - w.since)) for w in live.workers),
        messages=() if live is None else live.messages[-5:],
    )


def shape_of(views: Sequence[LiveView]) -> str:
    """Return a hash that changes when parts appear or disappear, so that the page must be reloaded."""
    parts = [
        (
            view.id,
            view.state,
            [s.simulator for s in view.simulators],
            [w.worker for w in view.workers],
            len(view.messages),
        )
        for view in views
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


brief = partial(format_duration, brief=True)


def _last_report_at(entry: RunEntry) -> float:
    """Time of the last report of a run, or of its start (seconds since 1970, UTC)."""
    return entry.started_at if entry.live is None else max(entry.live.at, entry.started_at)


def _counts(simulator: LiveSimulator) -> Counts:
    return Counts(simulator.planned, simulator.successes, simulator.failures, simulator.errors)


def _rate(counts: Counts) -> str:
    return "no result yet" if counts.rate is None else f"{percent(counts.rate)} {span(counts.interval)}"


def _simulator(live: LiveSimulator, silent: bool) -> SimulatorView:
    """The view of a simulator; a silent run has no speed and no time left."""
    pace, left_s = (None, None) if silent else (live.per_minute, live.left_s)
    counts = _counts(live)
    whole = max(live.planned, live.done, 1)
    rate, left = _rate(counts), NOTHING if left_s is None else brief(left_s)
    progress = f"{count(live.done)} of {count(live.planned)} episodes, success {rate}, {count(live.errors)} errors"
    return SimulatorView(
        simulator=live.simulator,
        planned=live.planned,
        done=live.done,
        successes=live.successes,
        failures=live.failures,
        errors=live.errors,
        shares=(
            round(100 * live.successes / whole, 2),
            round(100 * live.failures / whole, 2),
            round(100 * live.errors / whole, 2),
        ),
        rate=rate,
        per_minute=NOTHING if pace is None else f"{pace:,.3g}",
        left=left,
        progress=progress + ("" if left_s is None else f", {left} left"),
    )
