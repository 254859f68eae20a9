"""Results of a policy from run to run, and leaderboards, as tables."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from robogauntlet.results.analysis.leaderboard import LeaderboardRow
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, percent, span
from robogauntlet.results.store.history_records import Counts, PolicyRunResult

MARKS = {"regressed": "▼", "improved": "▲", "not comparable": "≠"}


def when(seconds: float | None) -> str:
    """A time (seconds since 1970) as `2026-11-22 02:00` (UTC); `–` if there is none or no calendar has it."""
    if seconds is None:
        return NOTHING
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M}"
    except (OverflowError, OSError, ValueError):
        return NOTHING


def verdict_text(verdict: str | None, *, accepted: bool = False) -> str:
    """A verdict with its symbol."""
    words = NOTHING if verdict is None else f"{MARKS[verdict]} {verdict}" if verdict in MARKS else verdict
    return f"{words}, accepted" if accepted else words


def run_rate(counts: Counts, policies: int) -> str:
    """The rate of a run's episodes, `86 % [82, 89]`; for several policies their number, since a rate would mix them."""
    if policies > 1:
        return f"{policies:,} policies"
    return NOTHING if counts.rate is None else f"{percent(counts.rate)} {span(counts.interval)}"


def policy_history_table(results: Sequence[PolicyRunResult]) -> TextTable:
    """The results of a policy, with a row per run."""
    header = ("started (UTC)", "run", "suite", "content", "verdict", "rate", "interval", "episodes", "errors")
    rows = tuple(
        (
            when(result.run.started_at),
            result.run.name,
            result.run.suite,
            result.policy_digest[:8],
            verdict_text(result.run.verdict, accepted=result.run.accepted),
            percent(result.counts.rate),
            span(result.counts.interval),
            count(result.counts.verdicts),
            count(result.counts.errors),
        )
        for result in results
    )
    return TextTable(header, rows, 5)


def leaderboard_table(leaderboard: Sequence[LeaderboardRow]) -> TextTable:
    """A leaderboard; policies that share a letter do not differ significantly."""
    header = ("policy", "content", "letters", "run", "started (UTC)", "success", "interval", "episodes")
    rows = tuple(
        (
            row.policy,
            row.policy_digest[:8],
            row.letters,
            row.run,
            when(row.started_at),
            percent(row.rate),
            span(row.interval),
            count(row.verdicts),
        )
        for row in leaderboard
    )
    return TextTable(header, rows, 5)


def sparkline(results: Sequence[PolicyRunResult]) -> str:
    """Rates as a line of block characters from 0 to 100 %; a dot is a run without a rate."""
    blocks = "▁▂▃▄▅▆▇█"
    rates = [result.counts.rate for result in results]
    return "".join("·" if rate is None else blocks[min(int(rate * len(blocks)), len(blocks) - 1)] for rate in rates)
