"""The page that compares two runs."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from robogauntlet.orchestrator.dashboard.app_state import CurrentAppState
from robogauntlet.results.analysis.comparison import Comparison
from robogauntlet.results.api import compare, open_entry
from robogauntlet.results.report import comparison as words
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.results.store.run_history import History

router = APIRouter()


@router.get("/compare")
def compare_runs(app_state: CurrentAppState, run: str = "", baseline: str = "") -> Response:
    """Compare a run with a baseline run. The comparison is computed at the first request."""
    sides = [app_state.run_named(name) if name else None for name in (run, baseline)]
    comparison: Comparison | None = None
    problem = ""
    if sides[0] is not None and sides[1] is not None:
        first, second = sides[0], sides[1]
        try:
            key = tuple((entry.run_id, entry.status, entry.finished_at, entry.counts) for entry in (first, second))
            comparison = app_state.comparisons.get(key, lambda: _compare(app_state.history, first, second))
        except RunError as error:
            problem = str(error)
    return app_state.page(
        "compare.html.jinja",
        here="/runs",
        entries=sides,
        selected={"run": run, "baseline": baseline},
        comparison=comparison,
        words=words,
        problem=problem,
        recent=app_state.history.runs(limit=60),
    )


def _compare(history: History, run: RunEntry, baseline: RunEntry) -> Comparison:
    """Compare two runs. Raises RunError if the rows of one cannot be read."""
    return compare(open_entry(history, run), open_entry(history, baseline))
