"""The page that compares two runs."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from robogauntlet.orchestrator.dashboard.app_state import CurrentAppState
from robogauntlet.results.analysis.comparison import Comparison
from robogauntlet.results.api import compare, open_entry
from robogauntlet.results.report import comparison as report
from robogauntlet.results.run_document import RunError

router = APIRouter()


@router.get("/compare")
def compare_runs(app_state: CurrentAppState, run: str = "", baseline: str = "") -> Response:
    """Compare a run with a baseline run. The comparison is computed at the first request."""
    history = app_state.history
    first, second = (app_state.run_named(name) if name else None for name in (run, baseline))
    comparison: Comparison | None = None
    problem = ""
    if first is not None and second is not None:
        try:
            key = tuple((entry.run_id, entry.status, entry.finished_at, entry.counts) for entry in (first, second))
            comparison = app_state.comparisons.get(
                key, lambda: compare(open_entry(history, first), open_entry(history, second))
            )
        except RunError as error:
            problem = str(error)
    return app_state.page(
        "compare.html.jinja",
        here="/runs",
        entries=[first, second],
        selected={"run": run, "baseline": baseline},
        comparison=comparison,
        report=report,
        problem=problem,
        recent=history.runs(limit=60),
    )
