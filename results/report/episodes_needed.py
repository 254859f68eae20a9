"""How many seeds a suite needs, as text."""

from __future__ import annotations

from collections.abc import Sequence

from robogauntlet.results.analysis.episodes_needed import WIDTH, SeedsNeeded
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, counted, percent, seconds
from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.statistics.pairs import POWER


def seeds_table(answers: Sequence[SeedsNeeded], seeds: int) -> TextTable:
    """A line per question: the seeds that it needs, and what the suite's number of seeds gives."""
    timed = any(one.worker_s is not None for one in answers)
    header = ("", "seeds", "episodes", *(("worker time",) if timed else ()), f"{counted(seeds, 'seed')} give", "enough")
    rows = []
    for one in answers:
        time = (seconds(one.worker_s),) if timed else ()
        wanted = f"over {one.most_seeds:,}" if one.seeds is None else count(one.seeds)
        played = NOTHING if one.episodes is None else count(one.episodes)
        enough = "yes" if one.is_enough else "no"
        rows.append((_question(one), wanted, played, *time, _reached(one), enough))
    return TextTable(header, tuple(rows), 1)


def assumptions(answers: Sequence[SeedsNeeded], seeds: int) -> list[str]:
    """A sentence per question: what was assumed, where it is from, and how the answer is computed."""
    return [f"{_question(one)}: {_assumed(one)}; {_method(one, seeds)}{_too_few(one)}" for one in answers]


def _question(one: SeedsNeeded) -> str:
    tasks = "one task" if one.tasks == 1 else f"{one.tasks:,} tasks"
    return f"{'rate ±' if one.goal == WIDTH else 'difference of '}{_points(one.target)} points, {tasks}"


def _reached(one: SeedsNeeded) -> str:
    if one.reached is None:
        return NOTHING
    return f"{'±' if one.goal == WIDTH else ''}{100 * one.reached:.1f} points"


def _assumed(one: SeedsNeeded) -> str:
    what = "succeed" if one.goal == WIDTH else "of pairs disagree"
    return f"assumed that {_percent(one.assumed.share)} {what} ({one.assumed.source})"


def _method(one: SeedsNeeded, seeds: int) -> str:
    if one.goal == WIDTH:
        return f"half of Wilson's {100 * (1 - one.alpha):.0f} % interval"
    tests = round(ALPHA / one.alpha)
    shared = "" if tests == 1 else f" ({ALPHA:g} for {tests:,} tests together)"
    power = f"power {100 * POWER:.0f} %, with {counted(seeds, 'seed')} {percent(one.power)}"
    return f"McNemar's exact test at {one.alpha:.2g}{shared}, {power}"


def _too_few(one: SeedsNeeded) -> str:
    if one.seeds is not None:
        return ""
    return f"; a task has only {counted(one.most_seeds or 0, 'stored state')}; add tasks"


def _points(share: float) -> str:
    return f"{100 * share:.4g}"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
