"""The pages runs and run, and the live status."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, HTTPException, Query
from starlette.responses import Response

from robogauntlet.orchestrator.dashboard import queries
from robogauntlet.orchestrator.dashboard.app_state import AppState, CurrentAppState, query
from robogauntlet.orchestrator.dashboard.files import known_file
from robogauntlet.orchestrator.dashboard.live_view import live_view, shape_of
from robogauntlet.results.report.facts import provenance
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.history_records import CellCounts, Counts, RunEntry
from robogauntlet.suites.episode import CLEAN

PAGE = 50
"""Runs per page."""
LIVE_S = 0.5
"""Lifetime of the cached live status (s); it limits the load of the database, however many browsers watch."""
REPORTS = (
    ("report.html", "Report"),
    ("report.md", "as text"),
    ("summary.json", "as JSON"),
    ("cells.csv", "as a spreadsheet"),
)
PageNumber = Annotated[int, Query(ge=1, le=1_000_000)]
router = APIRouter()


@dataclass(frozen=True)
class Row:
    """Counts over several cells of a run."""

    simulator: str
    task: str | None
    """None for all tasks of the simulator."""
    policy: str
    condition: str
    """Clean, or the number of perturbed conditions."""
    counts: Counts


@router.get("/runs")
def list_runs(
    app_state: CurrentAppState, suite: str = "", status: str = "", policy: str = "", page: PageNumber = 1
) -> Response:
    """Show a page of the list of runs, the newest first."""
    wanted = queries.Filter(suite or None, status or None, policy or None)
    count = queries.count_runs(app_state.history, wanted)
    entries = queries.page_of_runs(app_state.history, wanted, PAGE, PAGE * (page - 1))
    return app_state.page(
        "runs.html.jinja",
        here="/runs",
        entries=entries,
        count=count,
        first=PAGE * (page - 1) + 1,
        page=page,
        pages=max(1, -(-count // PAGE)),
        wanted={"suite": suite, "status": status, "policy": policy},
        names=app_state.choices(),
    )


@router.get("/runs/{run_id}")
def show_run(app_state: CurrentAppState, run_id: str) -> Response:
    """Show a run: results, verdict and provenance."""
    entry = queries.run_of(app_state.history, run_id)
    if entry is None:
        raise HTTPException(404, "The history has no run with this id.")
    cells = app_state.history.cells(run_id)
    document = app_state.history.document(run_id)
    live = [live_view(entry, time.time())] if entry.status == "running" else []
    return app_state.page(
        "run.html.jinja",
        here="/runs",
        entry=entry,
        document=document,
        facts=_facts(entry, document),
        simulators=_sum_counts(cells, lambda cell: (cell.simulator, None)),
        tasks=_sum_counts(cells, lambda cell: (cell.simulator, cell.task)),
        baseline=None if entry.baseline is None else queries.run_of(app_state.history, entry.baseline),
        reports=[(file, label) for file, label in REPORTS if entry.folder and known_file(Path(entry.folder), file)],
        several=len({cell.policy for cell in cells}) > 1,
        live=live,
        shape=shape_of(live),
        poll=f"/api/live{query(run=run_id)}" if live else "",
    )


@router.get("/api/live")
def live(app_state: CurrentAppState, run: str = "") -> Response:
    """Return the live status of all running suites, or of one run, as JSON."""
    found = app_state.answers.get(("live", run), lambda: _live(app_state, run), LIVE_S)
    return Response(found, media_type="application/json")


def _live(app_state: AppState, run: str) -> bytes:
    now = time.time()
    if run:
        entry = queries.run_of(app_state.history, run)
        entries = [entry] if entry is not None and entry.status == "running" else []
    else:
        entries = running(app_state)
    views = [live_view(entry, now) for entry in entries]
    return json.dumps({"at": now, "shape": shape_of(views), "runs": views}).encode()


def running(app_state: AppState) -> list[RunEntry]:
    """Return the runs with the status "running", the newest first. Raises StoreError."""
    return app_state.history.runs(status="running", limit=PAGE)


def _sum_counts(cells: Sequence[CellCounts], place: Callable[[CellCounts], tuple[str, str | None]]) -> list[Row]:
    """Sum the counts of cells by place and policy, separately for clean and perturbed conditions."""
    groups: dict[tuple[str, str | None, str, bool], list[CellCounts]] = {}
    for cell in cells:
        groups.setdefault((*place(cell), cell.policy, cell.axis == CLEAN), []).append(cell)
    rows = []
    for (simulator, task, policy, is_clean), group in groups.items():
        conditions = len({(cell.axis, cell.severity) for cell in group})
        condition = CLEAN if is_clean else f"perturbed ({conditions} condition{'s' if conditions > 1 else ''})"
        rows.append(Row(simulator, task, policy, condition, sum((cell.counts for cell in group), Counts())))
    return sorted(rows, key=lambda row: (row.simulator, row.task or "", row.policy, row.condition != CLEAN))


def _facts(entry: RunEntry, document: RunDocument) -> list[tuple[str, str]]:
    """The origin of a run: schedule, software, hardware and skipped simulators."""
    schedule = [("schedule", entry.schedule)] if entry.schedule else []
    skipped = [(f"{name} skipped", reason) for name, reason in document.skipped.items()]
    return [*schedule, *provenance(document), *skipped, *sorted(document.provenance.versions.items())]
