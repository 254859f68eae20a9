"""The overview, a policy from night to night, the leaderboard, the schedule."""

from __future__ import annotations

import time
from dataclasses import dataclass

from fastapi import APIRouter
from starlette.responses import Response

from orchestrator.calendar.schedule import Schedule, ScheduleError, State
from orchestrator.dashboard import queries
from orchestrator.dashboard.desk import Desk, TheDesk
from orchestrator.dashboard.runs import running
from orchestrator.dashboard.views import live_view, shape_of
from orchestrator.standings import newest_played, newest_runs
from results.leaderboard import Standing, leaderboard
from results.report.nights import plot

LAST_VERDICTS = 6
LAST_FIRINGS = 50
NIGHTS = 200
router = APIRouter()


@dataclass(frozen=True)
class Due:
    """A schedule and when it is due next."""

    schedule: Schedule
    at: float | None
    """Seconds since 1970, UTC; None: never."""
    trouble: str = ""
    """Why that cannot be said."""


@router.get("/")
def overview(desk: TheDesk) -> Response:
    """What runs, what was found last, what is due."""
    now = time.time()
    live = [live_view(entry, now) for entry in running(desk)]
    due = [one for one in _due(desk, now) if one.at is not None]
    return desk.page(
        "overview.html.jinja",
        here="/",
        live=live,
        shape=shape_of(live),
        poll="/api/live",
        verdicts=queries.judged(desk.history, LAST_VERDICTS),
        newest=desk.history.runs(limit=LAST_VERDICTS),
        due=sorted(due, key=lambda one: one.at or 0.0)[:LAST_VERDICTS],
        statuses=queries.statuses(desk.history),
    )


@router.get("/history")
def history(desk: TheDesk, policy: str = "", suite: str = "", task: str = "") -> Response:
    """How a policy did from run to run."""
    nights = []
    if policy:
        nights = desk.history.nights(policy, suite=suite or None, task=task or None, limit=NIGHTS)
    title = ", ".join(filter(None, (policy, task, suite and f"suite {suite}")))
    return desk.page(
        "history.html.jinja",
        here="/history",
        nights=nights[::-1],
        drawn=plot(nights, title, "/runs/{run}") if nights else "",
        title=title,
        limit=NIGHTS,
        wanted={"policy": policy, "suite": suite, "task": task},
        names=desk.choices(),
        tasks=queries.tasks(desk.history, policy or None, suite or None),
    )


@router.get("/leaderboard")
def show_leaderboard(desk: TheDesk, suite: str = "") -> Response:
    """Each policy's newest run of a suite, side by side."""
    names = desk.choices()
    suite = suite or (names.suites[0] if len(names.suites) == 1 else "")
    standings: list[Standing] = []
    left_out: list[str] = []
    if suite:
        newest = newest_runs(desk.history, suite)
        key = (suite, *((entry.run_id, entry.finished_at, tuple(sorted(own))) for entry, own in newest))
        standings, left_out = desk.standings.get(key, lambda: _standings(desk, suite))
    return desk.page(
        "leaderboard.html.jinja",
        here="/leaderboard",
        suite=suite,
        names=names,
        standings=standings,
        left_out=left_out,
        runs={entry.name: entry.run_id for entry, _ in newest} if suite else {},
    )


@router.get("/schedule")
def schedule(desk: TheDesk) -> Response:
    """What is due when, and what became of what was."""
    return desk.page(
        "schedule.html.jinja",
        here="/schedule",
        due=_due(desk, time.time()),
        firings=desk.book.firings(limit=LAST_FIRINGS),
        bad=(State.FAILED, State.MISSED),
    )


def _standings(desk: Desk, suite: str) -> tuple[list[Standing], list[str]]:
    left_out: list[str] = []
    played = list(newest_played(desk.history, suite, left_out.append))
    return leaderboard(played) if played else [], left_out


def _due(desk: Desk, now: float) -> list[Due]:
    found = []
    for one in desk.book.schedules():
        try:
            found.append(Due(one, one.next_due(now)))
        except ScheduleError as error:
            found.append(Due(one, None, str(error)))
    return found
