"""Numbers for Prometheus, and whether the dashboard is well."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator

from fastapi import APIRouter
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.responses import Response

from orchestrator.calendar.schedule import ScheduleError
from orchestrator.dashboard import queries
from orchestrator.dashboard.desk import Desk, TheDesk
from orchestrator.dashboard.guard import line
from orchestrator.dashboard.views import SILENT, state_of
from results.comparison import Verdict

router = APIRouter()


@router.get("/healthz")
def health(desk: TheDesk) -> Response:
    """`ok`, or 503 with a line."""
    queries.is_there(desk.history)
    return line("ok", 200)


@router.get("/metrics")
def metrics(desk: TheDesk) -> Response:
    """Gauges in Prometheus' text format."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Gauges(desk))
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)


class _Gauges(Collector):
    def __init__(self, desk: Desk) -> None:
        self._desk = desk

    def describe(self) -> list[Metric]:
        """Nothing: what there is depends on the store."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Read the store. Raises StoreError."""
        now = time.time()
        running = self._desk.history.runs(status="running")
        silent = sum(state_of(entry, now) == SILENT for entry in running)
        counts = Counter(queries.statuses(self._desk.history))
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
            for one in entry.live.simulators if entry.live is not None else ():
                labels = [entry.run_id, entry.suite, one.simulator]
                planned.add_metric(labels, one.planned)
                done.add_metric(labels, one.done)
                for outcome, number in (("success", one.successes), ("failure", one.failures), ("error", one.errors)):
                    outcomes.add_metric([*labels, outcome], number)
        yield from (planned, done, outcomes)

        verdicts = GaugeMetricFamily(
            "robogauntlet_last_verdict", "1 for the verdict of a suite's last judged run.", labels=["suite", "verdict"]
        )
        for suite, last in queries.last_verdicts(self._desk.history).items():
            for verdict in Verdict:
                verdicts.add_metric([suite, str(verdict)], float(last == str(verdict)))
        yield verdicts

        due = GaugeMetricFamily(
            "robogauntlet_schedule_next_due_seconds", "When a schedule is due next (Unix time).", labels=["schedule"]
        )
        for schedule in self._desk.book.schedules():
            try:
                moment = schedule.next_due(now)
            except ScheduleError:
                continue
            if moment is not None:
                due.add_metric([schedule.name], moment)
        yield due
