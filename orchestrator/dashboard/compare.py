"""The page that compares two policies, the policies of a run, or a run with a baseline run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, HTTPException
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from robogauntlet.orchestrator.dashboard import queries
from robogauntlet.orchestrator.dashboard.app_state import AppState, CurrentAppState
from robogauntlet.results.analysis.comparison import Comparison
from robogauntlet.results.analysis.pairwise import PairwiseComparisons
from robogauntlet.results.api import compare, open_entry
from robogauntlet.results.report import comparison as report
from robogauntlet.results.report import pairwise as words
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.history_records import RunEntry

RECENT = 60
"""Number of runs to choose from, the newest."""
MOST_LINES = 2000
"""Largest number of lines, a task of a comparison each, of the page."""
LEAST_MARGIN, LARGEST_MARGIN = 0.0001, 0.9999
"""Range of a margin, as of `robogauntlet compare --margin` (a share)."""
router = APIRouter()


@dataclass(frozen=True)
class ChosenPolicy:
    """A policy of a run that was chosen on the page."""

    entry: RunEntry
    policy: str

    @property
    def value(self) -> str:
        """The choice in the address."""
        return f"{self.entry.run_id}:{self.policy}"


@router.get("/compare")
async def show_comparison(
    app_state: CurrentAppState,
    first: str = "",
    second: str = "",
    policies: str = "",
    run: str = "",
    baseline: str = "",
    margin: str = "",
) -> Response:
    """Compare `first` with `second` (ID:POLICY each), the `policies` of a run, or a `run` with a `baseline`.

    `margin` is the decrease of success that still counts as no worse, a share. Each comparison is computed at its
    first request.
    """
    share = _margin(margin)
    chosen = await run_in_threadpool(lambda: [_chosen(app_state, text) for text in (first, second)])
    entries = await run_in_threadpool(
        lambda: [app_state.run_named(name) if name else None for name in (policies, run, baseline)]
    )
    pairwise: PairwiseComparisons | None = None
    comparison: Comparison | None = None
    problem = ""
    try:
        if chosen[0] is not None and chosen[1] is not None:
            pairwise = await _compare_policies(app_state, chosen[0], chosen[1], share)
        elif entries[0] is not None:
            pairwise = await _compare_all(app_state, entries[0], share)
        elif entries[1] is not None and entries[2] is not None:
            comparison = await _compare_runs(app_state, entries[1], entries[2], share)
    except RunError as error:
        problem = str(error)
    compared = pairwise.comparisons if pairwise else comparison.policies if comparison else ()
    if (lines := sum(len(one.tasks) for one in compared)) > MOST_LINES:
        problem = (
            f"The comparison has {lines:,} lines, too many for this page; robogauntlet compare prints all of them."
        )
        pairwise = comparison = None
    values = {
        "here": "/compare",
        "chosen": chosen,
        "entries": entries,
        "pairwise": pairwise,
        "words": words,
        "comparison": comparison,
        "report": report,
        "problem": problem,
        "margin": share,
        "margins": (LEAST_MARGIN, LARGEST_MARGIN),
    }
    return await run_in_threadpool(_page, app_state, [one.entry for one in chosen if one], values)


def _page(app_state: AppState, chosen: list[RunEntry], values: dict[str, Any]) -> Response:
    """The page, with the newest runs and those that were chosen in its lists."""
    recent = app_state.history.runs(limit=RECENT)
    listed = list({entry.run_id: entry for entry in (*recent, *chosen)}.values())
    policies = queries.policies_of_runs(app_state.history, [entry.run_id for entry in listed])
    return app_state.page("compare.html.jinja", recent=recent, listed=listed, policies=policies, **values)


def _chosen(app_state: AppState, text: str) -> ChosenPolicy | None:
    """Return the choice of `ID:POLICY`. Raises HTTPException if there is no such run, StoreError."""
    run_id, _, policy = text.partition(":")
    return ChosenPolicy(app_state.run_named(run_id), policy) if run_id else None


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


def _key(margin: float | None, *parts: RunEntry | str) -> tuple[object, ...]:
    """A key that changes when one of the runs does."""
    return margin, *(p if isinstance(p, str) else (p.run_id, p.status, p.finished_at, p.counts) for p in parts)


async def _compare_policies(
    app_state: AppState, one: ChosenPolicy, other: ChosenPolicy, margin: float | None
) -> PairwiseComparisons:
    def compute() -> PairwiseComparisons:
        opened = open_entry(app_state.history, one.entry)
        beside = None if one.entry.run_id == other.entry.run_id else open_entry(app_state.history, other.entry)
        return opened.compare(one.policy, other.policy, other=beside, margin=margin)

    key = _key(margin, one.entry, one.policy, other.entry, other.policy)
    return await app_state.slow.answer(app_state.pairwise, key, compute)


async def _compare_all(app_state: AppState, entry: RunEntry, margin: float | None) -> PairwiseComparisons:
    def compute() -> PairwiseComparisons:
        return open_entry(app_state.history, entry).compare(margin=margin)

    return await app_state.slow.answer(app_state.pairwise, _key(margin, entry), compute)


async def _compare_runs(app_state: AppState, run: RunEntry, baseline: RunEntry, margin: float | None) -> Comparison:
    def compute() -> Comparison:
        return compare(open_entry(app_state.history, run), open_entry(app_state.history, baseline), margin=margin)

    return await app_state.slow.answer(app_state.comparisons, _key(margin, run, baseline), compute)
