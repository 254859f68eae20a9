"""A comparison of policies on separate trials in words and as a table."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.analysis.unpaired import UnpairedComparison, UnpairedContrast
from robogauntlet.results.report.formatting import TextTable, counted, difference, p_value, percent, points
from robogauntlet.results.statistics.rates import rate

ALL = "all tasks"
METHOD = (
    "Start states are not known, so that trials are not paired. Difference: success rate of the first policy minus "
    "that of the second in percentage points, with Newcombe's interval for separate trials. p: Fisher's exact test, "
    "two-sided, over all tasks stratified by them; adjusted by Holm's method over all comparisons, and over all tasks."
)


def headline(one: UnpairedComparison, title: str) -> str:
    """The result over all tasks in a line."""
    line = one.overall
    p = "p" if line.adjusted == line.p else "adjusted p"
    counts = f"{line.counts.first_trials:,} and {line.counts.second_trials:,} trials"
    return f"{title}: {difference(line.difference)}, {p} {p_value(line.adjusted)}, not paired: {counts}"


def sentences(one: UnpairedComparison, names: tuple[str, str], alpha: float, margin: float | None) -> Iterator[str]:
    """What the comparison shows, and what was left out."""
    (first, second), line = names, one.overall
    rates = f"{first} {_rates(line)[0]}, {second} {_rates(line)[1]}"
    significant = f"The difference is significant at {100 * alpha:g} %"
    found = significant if line.adjusted <= alpha else "No difference is shown"
    yield f"Success in separate trials: {rates}. {found}."
    if len(one.tasks) > 1:
        differ = [f"{line.task} ({difference(line.difference)})" for line in one.tasks if line.adjusted <= alpha]
        listed = f": {', '.join(differ)}" if differ else ""
        yield f"Tasks with a difference after adjustment: {len(differ)} of {len(one.tasks)}{listed}."
    if not one.is_balanced:
        yield "Each has other shares of its trials in the tasks: the difference over all mixes tasks; p does not."
    if margin is not None and line.difference.interval is not None:
        is_shown = "It is shown" if line.difference.interval.low > -margin else "It is not shown"
        yield f"{is_shown} that {first} is no worse than {second} by more than {100 * margin:g} points."
    if any(one.errors):
        yield f"Left out: {counted(one.errors[0], 'error')} of {first}, {one.errors[1]:,} of {second}."
    if any(one.alone):
        yield (
            f"Left out, in tasks that the other did not play: {counted(one.alone[0], 'trial')} of {first}, "
            f"{one.alone[1]:,} of {second}."
        )


def table(one: UnpairedComparison, names: tuple[str, str]) -> TextTable:
    """The tasks, and all tasks if there are several."""
    lines = [*one.tasks, *([one.overall] if len(one.tasks) > 1 else [])]
    header = ("task", *names, "difference", "p", "adjusted p")
    rows = [
        (line.task or ALL, *_rates(line), points(line.difference), p_value(line.p), p_value(line.adjusted))
        for line in lines
    ]
    return TextTable(header, tuple(rows), 1)


def _rates(line: UnpairedContrast) -> tuple[str, str]:
    one = line.counts
    sides = ((one.first, one.first_trials), (one.second, one.second_trials))
    first, second = (f"{percent(rate(won, trials))} ({won:,} of {trials:,})" for won, trials in sides)
    return first, second
