"""Running suites as pages and `/api/live` show them, with the same texts in both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import partial
from typing import Any

from robogauntlet.results.live_status import STALE_S, LiveSimulator, LiveStatus, LiveWorker
from robogauntlet.results.report.formatting import NOTHING, count
from robogauntlet.results.report.history_tables import run_rate
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.history_records import Counts, RunEntry
from robogauntlet.support.durations import format_duration, format_range
from robogauntlet.support.text import counted

SILENT = "silent"
"""State of a run whose status is "running" but which has not reported for `STALE_S`."""


def state_of(entry: RunEntry, now: float) -> str:
    """Return the status of a run; `SILENT` if it is "running" but has not reported for `STALE_S`."""
    return SILENT if entry.status == "running" and now - _last_report_at(entry) > STALE_S else entry.status


def state_text_of(entry: RunEntry, now: float) -> str:
    """Return the state of a run as text; a complete run may still record videos."""
    state = state_of(entry, now)
    if entry.live is not None and state == RunStatus.COMPLETE and now - entry.live.at <= STALE_S:
        return f"{state}, {entry.live.phase}"
    text = f"silent for {brief(now - _last_report_at(entry))}" if state == SILENT else state
    return f"{text}, imported" if entry.imported else text


def counts_of(entry: RunEntry) -> Counts:
    """Return the counts of a run; while it is running, those of its live status."""
    if entry.status != "running" or entry.live is None or not entry.live.simulators:
        return entry.counts
    return sum(map(_counts, entry.live.simulators), Counts())


def live_view(entry: RunEntry, now: float) -> dict[str, Any]:
    """Return what pages and `/api/live` show of a running suite, at a time in seconds since 1970 (UTC)."""
    counts, live = counts_of(entry), entry.live
    silent = state_of(entry, now) == SILENT
    return {
        "id": entry.run_id,
        "name": entry.name,
        "suite": entry.suite,
        "state": state_of(entry, now),
        "state_text": state_text_of(entry, now),
        "phase": "" if live is None or silent else _phase(live),
        "done": counts.done,
        "planned": counts.planned,
        "errors": counts.errors,
        "rate": _rate(counts, entry.policies),
        "simulators": [] if live is None else [_simulator(one, silent, entry.policies) for one in live.simulators],
        "workers": [] if live is None or silent else [_worker(worker, now) for worker in live.workers],
        "messages": [] if live is None else live.messages[-5:],
    }


def shape_of(views: Sequence[dict[str, Any]]) -> str:
    """Return a hash that changes when parts appear or disappear, so that the page must be reloaded."""
    parts = [
        (
            *(view["id"], view["state"], len(view["messages"])),
            [simulator["simulator"] for simulator in view["simulators"]],
            [worker["worker"] for worker in view["workers"]],
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


def _phase(live: LiveStatus) -> str:
    return live.phase if live.left_s is None else f"{live.phase}, {format_range(*live.left_s)} left"


def _rate(counts: Counts, policies: int) -> str:
    if counts.rate is None:
        return "no result yet"
    return f"no rate over {policies:,} policies" if policies > 1 else run_rate(counts, policies)


def _worker(worker: LiveWorker, now: float) -> dict[str, Any]:
    doing, since = worker.activity, brief(now - worker.since)
    return {"worker": worker.worker, "simulator": worker.simulator, "doing": doing, "since": since}


def _simulator(live: LiveSimulator, silent: bool, policies: int) -> dict[str, Any]:
    """The progress of a simulator's episodes; a silent run has no speed."""
    pace, whole, rate = (
        None if silent else live.per_minute,
        max(live.planned, live.done, 1),
        _rate(_counts(live), policies),
    )
    progress = (
        f"{count(live.done)} of {counted(live.planned, 'episode')}, success {rate}, {counted(live.errors, 'error')}"
    )
    return {
        "simulator": live.simulator,
        "planned": live.planned,
        "done": live.done,
        "successes": live.successes,
        "failures": live.failures,
        "errors": live.errors,
        # Percent of the planned episodes.
        "shares": [round(100 * number / whole, 2) for number in (live.successes, live.failures, live.errors)],
        "rate": rate,
        "per_minute": NOTHING if pace is None else f"{pace:,.3g}",
        "progress": progress,  # for screen readers
    }
