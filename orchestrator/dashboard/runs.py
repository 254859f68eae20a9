"""The list of runs, and one run."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, HTTPException, Query
from starlette.responses import Response

from orchestrator.dashboard import queries
from orchestrator.dashboard.desk import Desk, TheDesk, query
from orchestrator.dashboard.files import known_file
from orchestrator.dashboard.views import live_view, shape_of
from results.entries import CellCounts, Counts, RunEntry
from results.report.nights import when
from results.report.text import seconds
from results.run import RunDocument, RunError
from suites.vocabulary import CLEAN

PAGE = 50
"""Runs on a page of the list."""
REPORTS = (
    ("report.html", "Report"),
    ("explore.html", "Plots to turn over by hand"),
    ("report.md", "as text"),
    ("summary.json", "as JSON"),
    ("cells.csv", "as a spreadsheet"),
)
PageNumber = Annotated[int, Query(ge=1, le=1_000_000)]
router = APIRouter()


@dataclass(frozen=True)
class Row:
    """Cells of a run taken together."""

    simulator: str
    task: str | None
    """None: all of the simulator."""
    policy: str
    condition: str
    """Clean, or how many perturbed ones."""
    counts: Counts


@router.get("/runs")
def list_runs(desk: TheDesk, suite: str = "", status: str = "", policy: str = "", page: PageNumber = 1) -> Response:
    """Runs, the newest first, a page of them."""
    wanted = queries.Filter(suite or None, status or None, policy or None)
    count = queries.count_runs(desk.history, wanted)
    entries = queries.page_of_runs(desk.history, wanted, PAGE, PAGE * (page - 1))
    return desk.page(
        "runs.html.jinja",
        here="/runs",
        entries=entries,
        count=count,
        first=PAGE * (page - 1) + 1,
        page=page,
        pages=max(1, -(-count // PAGE)),
        wanted={"suite": suite, "status": status, "policy": policy},
        names=desk.choices(),
    )


@router.get("/runs/{run_id}")
def show_run(desk: TheDesk, run_id: str) -> Response:
    """One run: what came of it, the verdict, with what it was made."""
    entry = queries.run_of(desk.history, run_id)
    if entry is None:
        raise HTTPException(404, "The history has no run of this id.")
    cells = desk.history.cells(run_id)
    try:
        document = desk.history.document(run_id)
    except RunError:
        document = None  # of an older version: its counts are there
    live = [live_view(entry, time.time())] if entry.status == "running" else []
    return desk.page(
        "run.html.jinja",
        here="/runs",
        entry=entry,
        document=document,
        facts=_facts(entry, document),
        simulators=_together(cells, lambda cell: (cell.simulator, None)),
        tasks=_together(cells, lambda cell: (cell.simulator, cell.task)),
        baseline=None if entry.baseline is None else queries.run_of(desk.history, entry.baseline),
        reports=[] if entry.folder is None else _reports(Path(entry.folder)),
        live=live,
        shape=shape_of(live),
        poll=f"/api/live{query(run=run_id)}" if live else "",
    )


@router.get("/api/live")
def live(desk: TheDesk, run: str = "") -> Response:
    """What runs at this moment, or one run, for programs and for the pages' script."""
    return Response(desk.lives.get(run, lambda: _live(desk, run)), media_type="application/json")


def _live(desk: Desk, run: str) -> bytes:
    now = time.time()
    if run:
        entry = queries.run_of(desk.history, run)
        entries = [entry] if entry is not None and entry.status == "running" else []
    else:
        entries = running(desk)
    views = [live_view(entry, now) for entry in entries]
    return json.dumps({"at": now, "shape": shape_of(views), "runs": [asdict(view) for view in views]}).encode()


def running(desk: Desk) -> list[RunEntry]:
    """Runs that say that they run, the newest first. Raises StoreError."""
    return desk.history.runs(status="running", limit=PAGE)


def _reports(folder: Path) -> list[tuple[str, str]]:
    return [(name, words) for name, words in REPORTS if known_file(folder, name) is not None]


def _together(cells: Sequence[CellCounts], place: Callable[[CellCounts], tuple[str, str | None]]) -> list[Row]:
    """Sums of cells by place and policy; the perturbed conditions apart from the clean one."""
    found: dict[tuple[str, str | None, str, bool], list[CellCounts]] = {}
    for cell in cells:
        found.setdefault((*place(cell), cell.policy, cell.axis == CLEAN), []).append(cell)
    rows = []
    for (simulator, task, policy, is_clean), own in found.items():
        conditions = len({(cell.axis, cell.severity) for cell in own})
        words = CLEAN if is_clean else f"perturbed ({conditions} condition{'s' if conditions > 1 else ''})"
        rows.append(Row(simulator, task, policy, words, sum((cell.counts for cell in own), Counts())))
    return sorted(rows, key=lambda row: (row.simulator, row.task or "", row.policy, row.condition != CLEAN))


def _facts(entry: RunEntry, document: RunDocument | None) -> list[tuple[str, str]]:
    """With what, where and when the run was made."""
    facts = [("run id", entry.run_id), ("begun", f"{when(entry.started_at)} UTC")]
    if entry.finished_at is not None:
        facts.append(("ended", f"{when(entry.finished_at)} UTC"))
    facts += [("schedule", entry.schedule)] if entry.schedule else []
    if document is None:
        return facts
    made = document.provenance
    dirty = {None: "", True: " with uncommitted changes", False: " (clean)"}[made.git_dirty]
    facts += [
        ("time running", seconds(document.elapsed_s)),
        ("suite hash", document.suite_hash),
        ("rows hash", document.rows_hash or "not computed"),
        *((f"policy {name}", digest) for name, digest in {c.policy: c.policy_digest for c in document.plan}.items()),
        ("git commit", f"{made.git_commit}{dirty}" if made.git_commit else "unknown"),
        *((f"{name} drawn by", device) for name, device in document.render_devices.items()),
        *((f"{name} skipped", reason) for name, reason in document.skipped.items()),
        (
            "machine",
            ", ".join(filter(None, (made.processor, f"{made.cores} cores" if made.cores else ""))) or "unknown",
        ),
        ("Python", made.python or "unknown"),
        *sorted(made.versions.items()),
    ]
    return facts
