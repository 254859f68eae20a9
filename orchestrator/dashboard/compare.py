"""The page that compares two policies, the policies of a run, or a run with a baseline run."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fastapi import APIRouter, HTTPException
from starlette.responses import Response

from robogauntlet.orchestrator.dashboard import queries
from robogauntlet.orchestrator.dashboard.app_state import AppState, CurrentAppState
from robogauntlet.results.api import ComparedSeparately, Comparison, compare, open_entry
from robogauntlet.results.report import comparison as report, pairwise as words
from robogauntlet.results.report.blocks import Block, Table
from robogauntlet.results.report.page import render_blocks
from robogauntlet.results.report.sections.pairwise import comparison_blocks
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.history_records import RunEntry

RECENT = 60
"""Number of runs to choose from, the newest."""
LEAST_MARGIN, LARGEST_MARGIN = 0.0001, 0.9999
"""Range of a margin, as of `robogauntlet compare --margin` (a share)."""
router = APIRouter()


@dataclass(frozen=True)
class Side:
    """A run, or a policy of it, that was chosen on the page."""

    entry: RunEntry
    policy: str
    """Empty for the run."""

    @property
    def value(self) -> str:
        """The choice in the address."""
        return f"{self.entry.run_id}:{self.policy}" if self.policy else self.entry.run_id


@router.get("/compare")
async def show_comparison(app_state: CurrentAppState, first: str = "", second: str = "", margin: str = "") -> Response:
    """Compare two policies (ID:POLICY each), the policies of the run `first` (ID), or it with the run `second`.

    `margin` is the decrease of success that still counts as no worse, a share. Each comparison is computed at its
    first request.
    """
    return await app_state.slowly(_show, app_state, first, second, margin)


def _show(app_state: AppState, first: str, second: str, margin: str) -> Response:
    share = _margin(margin)
    sides = [_side(app_state, text) for text in (first, second) if text]
    found: Comparison | None = None
    problem = ""
    try:
        found = _compare(app_state, sides, share) if sides else None
    except RunError as error:
        problem = str(error)
    recent = app_state.history.runs(limit=RECENT)
    listed = list({entry.run_id: entry for entry in (*recent, *(side.entry for side in sides))}.values())
    return app_state.page(
        "compare.html.jinja",
        here="/compare",
        sides=(*sides, None, None)[:2],
        found=found,
        problem=problem,
        listed=listed,
        policies=queries.policies_of_runs(app_state.history, [entry.run_id for entry in listed]),
        words=words,
        comparison_blocks=comparison_blocks,
        draw=render_blocks,
        separate=_separate_tables(found),
        report=report,
        margin=share,
        margins=(LEAST_MARGIN, LARGEST_MARGIN),
    )


def _separate_tables(found: Comparison | None) -> list[Block]:
    """The tables of two runs that were compared on separate trials."""
    if not isinstance(found, ComparedSeparately):
        return []
    return [Table(shown, title) for title, own in report.tables(found) for shown in own]


def _side(app_state: AppState, text: str) -> Side:
    """Return the choice of `ID` or `ID:POLICY`. Raises HTTPException if there is no such run, StoreError."""
    run_id, _, policy = text.partition(":")
    return Side(app_state.run_named(run_id), policy)


def _margin(text: str) -> float | None:
    """Return a margin, None for an empty text. Raises HTTPException unless it is a share in the range."""
    if not text.strip():
        return None
    try:
        share = float(text) if text.isascii() else math.nan
    except ValueError:
        share = math.nan
    if not LEAST_MARGIN <= share <= LARGEST_MARGIN:
        raise HTTPException(
            400, f"margin: expected a share from {LEAST_MARGIN} to {LARGEST_MARGIN}, or nothing; got '{text[:40]}'"
        )
    return share


def _compare(app_state: AppState, sides: list[Side], margin: float | None) -> Comparison:
    """Compare what was chosen, from the cache if the runs have not changed. Raises RunError, StoreError."""
    entries = [side.entry for side in sides]

    def compute() -> Comparison:
        one, *rest = (open_entry(app_state.history, entry) for entry in {e.run_id: e for e in entries}.values())
        match [side.policy for side in sides]:
            case [""]:
                return one.compare(margin=margin)
            case ["", ""] if rest:
                return compare(one, rest[0], margin=margin)
            case [first, second] if first and second:
                return one.compare(first, second, other=rest[0] if rest else None, margin=margin)
        raise RunError("expected two policies, two runs, or one run, whose policies are compared with each other")

    states = [(entry.status, entry.finished_at, entry.counts) for entry in entries]
    return app_state.answers.get(("compare", margin, *(side.value for side in sides), *states), compute)
