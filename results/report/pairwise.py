"""A comparison of policies as text, Markdown and JSON, and its forest plots."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from robogauntlet.results.analysis.comparison import PolicyComparison
from robogauntlet.results.analysis.contrasts import Contrast
from robogauntlet.results.analysis.leaderboard import MOST_POLICIES
from robogauntlet.results.analysis.pairwise import ALL_PAIRS, PolicyComparisons
from robogauntlet.results.analysis.unpaired import UnpairedComparison
from robogauntlet.results.report import formatting, paired_behaviour, unpaired
from robogauntlet.results.report.blocks import Forest, ForestGroup, ForestRow
from robogauntlet.results.report.facts import DEFINITIONS, PAIRWISE_TERMS
from robogauntlet.results.report.formatting import (
    NOTHING,
    TextTable,
    aligned,
    counted,
    difference,
    escape,
    markdown,
    p_value,
    percent,
    short_task,
)
from robogauntlet.results.statistics.pairs import POWER
from robogauntlet.results.statistics.rates import rate

BEGINS = (
    rb"(### )?[^\n]+ against [^\n]+: [^\n]+ points, [^\n]+ (pairs?|trials)\n"
    rb"|(\| )?policy +(\| )?letters +(\| )?success"
    rb"|(\| )?(all tasks|against [^\n]+?) +(\| )?pairs +(\| )?first +(\| )?second"
    rb"|\{\n \"alpha\": [^\n]*\n \"baseline\": "
)
"""How comparisons of policies begin, in each of their forms: a regular expression."""
ALL = "all tasks"
CLEAN_TITLE = "Outcomes of the pairs in which one or both failed"
PERTURBED_TITLE = "Outcomes of the perturbed pairs in which one or both failed"
REACHES = (0.1, 0.25, 0.5, 1.0)
"""Possible ends of the axis of a forest plot, a difference of rates."""


def names(one: PolicyComparison | UnpairedComparison) -> tuple[str, str]:
    """The policies, with their runs if these differ."""
    sides = (one.first, one.second)
    several = one.first.run != one.second.run
    first, second = (f"{side.run}:{side.policy}" if several else side.policy for side in sides)
    return first, second


def title(one: PolicyComparison | UnpairedComparison) -> str:
    """`merged against experts`."""
    return " against ".join(names(one))


def headline(one: PolicyComparison | UnpairedComparison) -> str:
    """The result over all tasks in a line."""
    if isinstance(one, UnpairedComparison):
        return unpaired.headline(one, title(one))
    line = one.overall
    p = "p" if line.adjusted == line.p else "adjusted p"
    found = f"{difference(line.difference)}, {p} {p_value(line.adjusted)}"
    return f"{title(one)}: {found}, {counted(line.pairs.trials, 'pair')}"


def sentences(one: PolicyComparison | UnpairedComparison, comparisons: PolicyComparisons) -> list[str]:
    """What the comparison shows, and what was left out."""
    if isinstance(one, UnpairedComparison):
        return list(unpaired.sentences(one, names(one), comparisons.alpha, comparisons.margin))
    moved = () if one.behaviour is None else paired_behaviour.sentences(one.behaviour, *names(one), comparisons.alpha)
    return [*_found(one, comparisons), *moved, *_left_out(one)]


def _found(one: PolicyComparison, comparisons: PolicyComparisons) -> Iterator[str]:
    (first, second), line, alpha = names(one), one.overall, comparisons.alpha
    rates = [percent(rate(won, line.pairs.trials)) for won in (line.pairs.first, line.pairs.second)]
    significant = f"The difference is significant at {100 * alpha:g} %."
    several = len(comparisons.comparisons) > 1
    found = significant if line.adjusted <= alpha else f"No difference is shown. {_detectable(line, several)}"
    yield f"Success in {counted(line.pairs.trials, 'episode')}: {first} {rates[0]}, {second} {rates[1]}. {found}"
    if one.parts:
        differ = [line for line in one.tasks if line.adjusted <= alpha]
        listed = f": {', '.join(f'{line.task} ({difference(line.difference)})' for line in differ)}" if differ else ""
        yield f"Tasks with a difference after adjustment: {len(differ)} of {len(one.tasks)}{listed}."
    if one.conditions:
        shown = [line for line in one.conditions if line.adjusted <= alpha]
        listed = (
            f": {', '.join(f'{line.condition} ({difference(line.difference)})' for line in shown)}" if shown else ""
        )
        yield f"Perturbed conditions with a difference: {len(shown)} of {len(one.conditions)}{listed}."
    if line.no_worse is not None and comparisons.margin is not None:
        is_shown = "It is shown" if line.no_worse else "It is not shown"
        yield f"{is_shown} that {first} is no worse than {second} by more than {100 * comparisons.margin:g} points."
    if one.is_same_policy:
        yield "Both have the same content."
    if one.identical:
        yield f"Both executed the same actions in {one.identical:,} of {counted(line.pairs.trials, 'pair')}."


def _detectable(line: Contrast, several: bool) -> str:
    if line.detectable is None:
        return "No difference can be detected with so few pairs."
    found = f"A difference of {100 * line.detectable:.1f} points is detected with a probability of {percent(POWER)}"
    return f"{found}{' before adjustment' if several else ''}."


def _left_out(one: PolicyComparison) -> Iterator[str]:
    first, second = names(one)
    if any(one.errors):
        yield f"Left out: {counted(one.errors[0], 'error')} of {first}, {one.errors[1]:,} of {second}."
    if any(one.unpaired):
        yield (
            f"Left out, since the other has no verdict: {counted(one.unpaired[0], 'episode')} of {first}, "
            f"{one.unpaired[1]:,} of {second}."
        )
    if any(one.perturbed_left_out):
        yield (
            f"Perturbed episodes without a verdict of both: {one.perturbed_left_out[0]:,} of {first}, "
            f"{one.perturbed_left_out[1]:,} of {second}; left out."
        )
    for kind, words in one.differences.items():
        yield f"{str(kind).capitalize()}: {words}."


def summary(comparisons: PolicyComparisons) -> list[str]:
    """Sentences on the whole: pairs that were not compared, and many policies."""
    lines = [f"Not compared: {reason}." for reason in comparisons.not_compared]
    if comparisons.is_adaptive:
        lines.append("The suite is adaptive: the number of pairs depends on outcomes, so the p-values are not exact.")
    if comparisons.baseline is None and comparisons.policies > MOST_POLICIES:
        lines.append(f"Pairs and letters of more than {MOST_POLICIES} policies are left out.")
    if comparisons.baseline is None and comparisons.policies > ALL_PAIRS:
        lines.append(
            f"{comparisons.policies} policies have too many pairs to list; "
            "robogauntlet compare RUN:A RUN:B compares two of them."
        )
    return lines


def method(comparisons: PolicyComparisons) -> str:
    """How the numbers were computed."""
    apart = [unpaired.METHOD] if comparisons.unpaired else []
    if not comparisons.comparisons:
        return "".join(apart)
    under = any(one.conditions for one in comparisons.comparisons)
    clean = (
        "Clean episodes, paired by task, seed and protocol. Difference: success rate of the first policy minus that of "
        f"the second in percentage points, with Newcombe's paired interval ({100 * (1 - comparisons.alpha):g} %). "
        "p: McNemar's exact test, two-sided; adjusted by Holm's method over all comparisons, and over those simulators "
        f"and tasks in which enough pairs disagree for the test to reach {comparisons.alpha:g}."
    )
    used = [*(["perturbed pairs"] if under else []), *(["median difference"] if _moves(comparisons) else [])]
    return " ".join([clean, *(DEFINITIONS[term] for term in used), *apart])


def _moves(comparisons: PolicyComparisons) -> bool:
    """Whether it is compared how policies move."""
    return any(one.behaviour is not None and one.behaviour.measures for one in comparisons.comparisons)


def _lines(one: PolicyComparison) -> list[tuple[str, str, Contrast]]:
    """Simulator, name and line of each row: tasks by simulator, then the simulator, and all tasks at the end."""
    if not one.parts:
        return [("", one.tasks[0].task or ALL, one.overall)]
    rows = []
    for simulator in dict.fromkeys(line.simulator for line in one.tasks):
        tasks = [line for line in one.tasks if line.simulator == simulator]
        pooled = [line for line in one.simulators if line.simulator == simulator]
        rows += [(simulator or "", short_task(line.task or ""), line) for line in tasks]
        rows += [(simulator or "", f"all of {simulator}", line) for line in pooled]
    return [*rows, ("", ALL, one.overall)]


def table(one: PolicyComparison | UnpairedComparison) -> TextTable:
    """All tasks, simulators and tasks of a comparison."""
    if isinstance(one, UnpairedComparison):
        return unpaired.table(one, names(one))
    rows = []
    for simulator, name, line in _lines(one):
        label = f"{simulator}/{name}" if line.task is not None and simulator else name
        rows.append((label, *_numbers(line)))
    return TextTable(("task", *_header(*names(one))), tuple(rows), 1)


def condition_table(one: PolicyComparison) -> TextTable | None:
    """The perturbed conditions of a comparison, all tasks together; None without any."""
    if not one.conditions:
        return None
    rows = tuple((str(line.condition), f"{line.tasks:,}", *_numbers(line)) for line in one.conditions)
    return TextTable(("condition", "tasks", *_header(*names(one))), rows, 1)


def behaviour_tables(one: PolicyComparison) -> list[tuple[str, TextTable]]:
    """How the two move and fail, titles and tables; none where that was not measured."""
    found = one.behaviour
    tables = []
    if found is not None and found.measures:
        tables.append(("How they move where both succeed", paired_behaviour.measure_table(found)))
    changes = {CLEAN_TITLE: () if found is None else found.changes, PERTURBED_TITLE: one.perturbed_changes}
    tables += [(title, paired_behaviour.change_table(own, *names(one))) for title, own in changes.items() if own]
    return tables


def overview_table(comparisons: PolicyComparisons) -> TextTable:
    """Several comparisons over all tasks, with a row each."""
    baseline = comparisons.baseline
    rows = tuple((_short_title(one, comparisons), *_numbers(one.overall)) for one in comparisons.comparisons)
    header = ("all tasks" if baseline is None else f"against {baseline}", *_header("first", "second"))
    return TextTable(header, rows, 1)


def _short_title(one: PolicyComparison, comparisons: PolicyComparisons) -> str:
    """The comparison among others: the first policy if all are compared with the baseline."""
    return title(one) if comparisons.baseline is None else names(one)[0]


def _header(first: str, second: str) -> tuple[str, ...]:
    tested = ("p", "adjusted p", "detectable")
    return ("pairs", first, second, "difference", "only first", "only second", *tested)


def _numbers(line: Contrast) -> tuple[str, ...]:
    pairs = line.pairs
    return (
        f"{pairs.trials:,}",
        percent(rate(pairs.first, pairs.trials)),
        percent(rate(pairs.second, pairs.trials)),
        formatting.points(line.difference),
        f"{pairs.first_only:,}",
        f"{pairs.second_only:,}",
        p_value(line.p),
        p_value(line.adjusted),
        NOTHING if line.detectable is None else f"{100 * line.detectable:.1f}",
    )


def standings_table(comparisons: PolicyComparisons) -> TextTable | None:
    """The policies with their rates and letters, the best first; None if there are no letters."""
    if not comparisons.standings:
        return None
    rows = tuple(
        (row.policy, row.letters, percent(row.rate), formatting.span(row.interval), f"{row.verdicts:,}")
        for row in comparisons.standings
    )
    return TextTable(("policy", "letters", "success", "interval", "episodes"), rows, 2)


def terms(comparisons: PolicyComparisons) -> list[tuple[str, str]]:
    """Terms of the section, with their definitions."""
    absent = set() if comparisons.comparisons else set(PAIRWISE_TERMS) - {"letters"}
    absent |= set() if comparisons.standings else {"letters"}
    absent |= set() if any(one.conditions for one in comparisons.comparisons) else {"perturbed pairs"}
    absent |= set() if _moves(comparisons) else {"median difference"}
    return [(term, DEFINITIONS[term]) for term in PAIRWISE_TERMS if term not in absent]


def task_forest(one: PolicyComparison, comparisons: PolicyComparisons) -> Forest:
    """A forest plot of the tasks, the simulators and all tasks of a comparison."""
    lines = _lines(one)
    groups = {simulator: [(n, line) for of, n, line in lines if of == simulator] for simulator, _, _ in lines}
    first, second = names(one)
    note = f"Right of 0, {first} succeeds more often; left of 0, {second}."
    return replace(_forest(title(one), note, groups, comparisons), about=title(one))


def overview_forest(comparisons: PolicyComparisons) -> Forest:
    """A forest plot of several comparisons over all tasks."""
    rows = [(_short_title(one, comparisons), one.overall) for one in comparisons.comparisons]
    name = ALL.capitalize() if comparisons.baseline is None else f"All tasks, against {comparisons.baseline}"
    better = "the policy named first" if comparisons.baseline is None else "the policy"
    return _forest(name, f"Right of 0, {better} succeeds more often.", {"": rows}, comparisons)


def _forest(
    name: str, note: str, groups: dict[str, list[tuple[str, Contrast]]], comparisons: PolicyComparisons
) -> Forest:
    ends = [abs(end) for rows in groups.values() for _, line in rows for end in _ends(line)]
    reach = next(reach for reach in REACHES if reach >= max(ends) or reach == REACHES[-1])

    def place(value: float) -> float:
        return round(50 + 50 * max(-1.0, min(1.0, value / reach)), 2)

    drawn = []
    for group, rows in groups.items():
        made = []
        for label, line in rows:
            low, high = _ends(line)
            positions = (place(low), place(line.difference.value), place(high))
            is_shown = line.adjusted <= comparisons.alpha
            made.append(ForestRow(label, formatting.points(line.difference), *positions, line.task is None, is_shown))
        drawn.append(ForestGroup(group, tuple(made)))
    ticks = tuple(f"{100 * part * reach:+g}" if part else "0" for part in (-1, -0.5, 0, 0.5, 1))
    note += f" A filled marker: adjusted p at most {comparisons.alpha:g}."
    if comparisons.margin is not None:
        note += f" The dashed line on the left is the margin of {100 * comparisons.margin:g} points."
    margin = None if comparisons.margin is None else place(-comparisons.margin)
    return Forest(name, note, ticks, margin, tuple(drawn))


def _ends(line: Contrast) -> tuple[float, float]:
    interval, value = line.difference.interval, line.difference.value
    return (value, value) if interval is None else (interval.low, interval.high)


def written(comparisons: PolicyComparisons, form: str) -> str:
    """The comparisons with their method: `text` for a terminal or a log, or GitHub's `markdown`."""
    draw, safe, heading, gap = (aligned, str, "", "\n") if form == "text" else (markdown, escape, "### ", "\n\n")
    parts = []
    if standings := standings_table(comparisons):
        parts += [draw(standings), safe(DEFINITIONS["letters"])]
    if len(comparisons.comparisons) > 1:
        parts.append(draw(overview_table(comparisons)))
    for one in comparisons.comparisons:
        found = "\n".join(f"- {safe(sentence)}" for sentence in sentences(one, comparisons))
        parts.append(f"{heading}{safe(headline(one))}{gap}{found}")
        parts += [draw(shown) for shown in (table(one), condition_table(one)) if shown]
        parts += [f"{title}:{gap}{draw(shown)}" for title, shown in behaviour_tables(one)]
    for apart in comparisons.unpaired:
        found = "\n".join(f"- {safe(sentence)}" for sentence in sentences(apart, comparisons))
        parts += [f"{heading}{safe(headline(apart))}{gap}{found}", draw(table(apart))]
    return "\n\n".join([*parts, *map(safe, filter(None, [*summary(comparisons), method(comparisons)]))]) + "\n"
