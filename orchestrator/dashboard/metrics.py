"""Metrics for Prometheus and the health check."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator

from fastapi import APIRouter
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.responses import Response

from robogauntlet.orchestrator.dashboard import queries
from robogauntlet.orchestrator.dashboard.app_state import AppState, CurrentAppState
from robogauntlet.orchestrator.dashboard.live_view import SILENT, state_of
from robogauntlet.orchestrator.dashboard.security import line
from robogauntlet.results.analysis.comparison import Verdict

router = APIRouter()


@router.get("/healthz")
def health(app_state: CurrentAppState) -> Response:
    """Answer `ok`, or 503 with the reason. Raises StoreError."""
    queries.check_readable(app_state.history)
    return line("ok", 200)


@router.get("/metrics")
def metrics(app_state: CurrentAppState) -> Response:
    """Return the gauges in Prometheus' text format."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Gauges(app_state))
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)


class _Gauges(Collector):
    def __init__(self, app_state: AppState) -> None:
        self._app_state = app_state

    def describe(self) -> list[Metric]:
        """Return nothing, since the metrics depend on the store."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Yield the gauges from the store. Raises StoreError."""
        now = time.time()
        running = self._app_state.history.runs(status="running")
        silent = sum(state_of(entry, now) == SILENT for entry in running)
        counts = Counter(queries.statuses(self._app_state.history))
        counts["running"] -= silent
        counts[SILENT] = silent
        runs = GaugeMetricFamily("robogauntlet_runs", "Runs in the history by status.", labels=["status"])
        for status, number in sorted(counts.items()):
            runs.add_metric([status], number)
        yield runs

        where = ["run", "suite", "simulator"]
        planned = GaugeMetricFamily("robogauntlet_running_planned", "Episodes planned by running suites.", labels=where)
        done = GaugeMetricFamily("robogauntlet_running_done", "Episodes that running suites have done.", labels=where)
        outcomes = GaugeMetricFamily(
            "robogauntlet_running_episodes", "Episodes of running suites by outcome.", labels=[*where, "outcome"]
        )
        for entry in running:
            for live in entry.live.simulators if entry.live is not None else ():
                labels = [entry.run_id, entry.suite, live.simulator]
                planned.add_metric(labels, live.planned)
                done.add_metric(labels, live.done)
                outcomes.add_metric([*labels, "success"], live.successes)
                outcomes.add_metric([*labels, "failure"], live.failures)
                outcomes.add_metric([*labels, "error"], live.errors)
        yield from (planned, done, outcomes)

        meaning = "1 for the verdict of the last compared run of a suite."
        verdicts = GaugeMetricFamily("robogauntlet_last_verdict", meaning, labels=["suite", "verdict"])
        for suite, last in queries.last_verdicts(self._app_state.history).items():
            for verdict in Verdict:
                verdicts.add_metric([suite, str(verdict)], float(last == str(verdict)))
        yield verdicts

        schedules = self._app_state.schedule_store.schedules()
        meaning = "1 if all schedules that a process served are served, else 0."
        served = all(schedule.is_served(now) for schedule in schedules)
        yield GaugeMetricFamily("robogauntlet_schedules_served", meaning, float(served))
        due = GaugeMetricFamily(
            "robogauntlet_schedule_next_due_seconds", "When a schedule is due next (Unix time).", labels=["schedule"]
        )
        for schedule in schedules:
            if schedule.next_due_at is not None:
                due.add_metric([schedule.name], schedule.next_due_at)
        yield due
