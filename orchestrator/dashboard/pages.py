"""The pages overview, history, leaderboard and schedule."""

from __future__ import annotations

import time

from fastapi import APIRouter
from starlette.responses import Response

from robogauntlet.orchestrator.dashboard import queries
from robogauntlet.orchestrator.dashboard.app_state import AppState, CurrentAppState
from robogauntlet.orchestrator.dashboard.live_view import live_view, shape_of
from robogauntlet.orchestrator.dashboard.runs import running
from robogauntlet.results.analysis.leaderboard import LeaderboardRow, leaderboard
from robogauntlet.results.newest_results import latest_results_per_policy

LAST_VERDICTS = 6
LAST_SCHEDULED_RUNS = 50
MAX_RUNS = 200
router = APIRouter()


@router.get("/")
def overview(app_state: CurrentAppState) -> Response:
    """Show running suites, the last verdicts and the next runs."""
    now = time.time()
    live = [live_view(entry, now) for entry in running(app_state)]
    schedules = app_state.schedule_store.schedules()
    return app_state.page(
        "overview.html.jinja",
        here="/",
        live=live,
        shape=shape_of(live),
        poll="/api/live",
        verdicts=queries.compared_runs(app_state.history, LAST_VERDICTS),
        newest=app_state.history.runs(limit=LAST_VERDICTS),
        due=sorted((one for one in schedules if one.next_due_at), key=lambda one: one.next_due_at or 0.0)[
            :LAST_VERDICTS
        ],
        statuses=queries.statuses(app_state.history),
    )


@router.get("/history")
def history(app_state: CurrentAppState, policy: str = "", suite: str = "", task: str = "") -> Response:
    """Show the success of a policy over its runs."""
    results = []
    if policy:
        results = app_state.history.policy_history(policy, suite=suite or None, task=task or None, limit=MAX_RUNS)
    title = ", ".join(filter(None, (policy, task, suite and f"suite {suite}")))
    return app_state.page(
        "history.html.jinja",
        here="/history",
        results=results[::-1],
        title=title,
        limit=MAX_RUNS,
        wanted={"policy": policy, "suite": suite, "task": task},
        names=app_state.choices(),
        tasks=queries.tasks(app_state.history, policy or None, suite or None),
    )


@router.get("/leaderboard")
async def show_leaderboard(app_state: CurrentAppState, suite: str = "") -> Response:
    """Compare the policies of a suite by their newest complete runs."""
    return await app_state.slowly(_leaderboard, app_state, suite)


def _leaderboard(app_state: AppState, suite: str) -> Response:
    names = app_state.choices()
    suite = suite or (names.suites[0] if len(names.suites) == 1 else "")
    newest = app_state.history.newest_runs(suite) if suite else []
    version = tuple((entry.run_id, entry.finished_at, tuple(sorted(policies))) for entry, policies in newest)
    standings, left_out = app_state.answers.get(("leaderboard", suite, version), lambda: _standings(app_state, suite))
    return app_state.page(
        "leaderboard.html.jinja",
        here="/leaderboard",
        suite=suite,
        names=names,
        standings=standings,
        left_out=left_out,
        runs={entry.name: entry.run_id for entry, _ in newest},
    )


@router.get("/schedule")
def schedule(app_state: CurrentAppState) -> Response:
    """Show the schedules and their last runs."""
    return app_state.page(
        "schedule.html.jinja",
        here="/schedule",
        schedules=app_state.schedule_store.schedules(),
        entries=queries.page_of_runs(app_state.history, queries.Filter(scheduled=True), LAST_SCHEDULED_RUNS, 0),
    )


def _standings(app_state: AppState, suite: str) -> tuple[list[LeaderboardRow], list[str]]:
    left_out: list[str] = []
    if not suite:
        return [], []
    played = list(latest_results_per_policy(app_state.history, suite, left_out.append))
    return leaderboard(played) if played else [], left_out
