"""Two runs against each other."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, HTTPException
from starlette.responses import Response

from orchestrator.dashboard import queries
from orchestrator.dashboard.desk import Desk, TheDesk
from results.comparison import Comparison
from results.entries import RunEntry, rows_url
from results.opening import OpenRun, compare
from results.report import comparison as words
from results.run import RunError

router = APIRouter()


@router.get("/compare")
def compare_runs(desk: TheDesk, run: str = "", baseline: str = "") -> Response:
    """A run held against an earlier one; computed when first asked for."""
    sides = [_named(desk, name) for name in (run, baseline)]
    found: Comparison | None = None
    trouble = ""
    if sides[0] is not None and sides[1] is not None:
        first, second = sides[0], sides[1]
        try:
            key = tuple((one.run_id, one.status, one.finished_at, one.counts) for one in (first, second))
            found = desk.comparisons.get(key, lambda: compare(_opened(desk, first), _opened(desk, second)))
        except RunError as error:
            trouble = str(error)
    return desk.page(
        "compare.html.jinja",
        here="/runs",
        entries=sides,
        asked={"run": run, "baseline": baseline},
        comparison=found,
        words=words,
        trouble=trouble,
        recent=desk.history.runs(limit=60),
    )


def _named(desk: Desk, name: str) -> RunEntry | None:
    """The run of that id or name; None if none was named. Raises HTTPException: there is none."""
    if not name:
        return None
    entry = queries.run_of(desk.history, name) or desk.history.find(name)
    if entry is None:
        raise HTTPException(404, f"The history has no run '{name[:80]}'.")
    return entry


def _opened(desk: Desk, entry: RunEntry) -> OpenRun:
    """Raises RunError: its rows or document cannot be had."""
    document = desk.history.document(entry.run_id)
    return OpenRun(Path(entry.folder or entry.name), document, rows_url(entry, desk.history.url))
