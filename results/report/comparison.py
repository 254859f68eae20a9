"""A comparison as text, Markdown and JSON. `pairwise` has the words on policies."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import asdict

from robogauntlet.results.analysis.comparison import Comparison, PolicyComparison, RunComparison, Verdict
from robogauntlet.results.analysis.contrasts import Contrast
from robogauntlet.results.analysis.pairwise import PolicyComparisons
from robogauntlet.results.analysis.separate_runs import SeparateRuns
from robogauntlet.results.report import paired_behaviour, pairwise, separate_runs
from robogauntlet.results.report.formatting import (
    NOTHING,
    TextTable,
    counted,
    difference,
    escape,
    markdown,
    p_value,
    percent,
    points,
)
from robogauntlet.results.statistics.pairs import Pairs
from robogauntlet.results.statistics.rates import rate

MARKS = {
    Verdict.REGRESSED: "REGRESSED",
    Verdict.IMPROVED: "improved",
    Verdict.NO_EVIDENCE: "no evidence of a difference",
    Verdict.NOT_COMPARABLE: "NOT COMPARABLE",
    Verdict.SEPARATE: "separate trials, not paired",
}
BEGINS = re.compile(
    rf"(### \S+ )?({'|'.join(map(re.escape, MARKS.values()))}): [^\n]+ against "
    r"|\{\n \"(agreement\": (null|\{)|allowed\": \[)|".encode()
    + pairwise.BEGINS
)
"""How a comparison begins, in each of its forms."""
NOW, BEFORE = "the run", "the baseline"


def headline(comparison: RunComparison) -> str:
    """The verdict and the names of the runs."""
    return f"{MARKS[comparison.verdict]}: {comparison.run} against {comparison.baseline}"


def in_one_line(comparison: RunComparison) -> str:
    """The headline, and the rates of the first policy over all tasks or why nothing is compared."""
    is_compared = comparison.comparisons and comparison.verdict is not Verdict.NOT_COMPARABLE
    why = outcome(comparison.comparisons[0].overall) if is_compared else reasons(comparison)[0]
    return f"{headline(comparison)}; {why}"


def reasons(comparison: RunComparison) -> list[str]:
    """The reasons of the verdict, a line each, with what the comparison can show."""
    if isinstance(comparison, SeparateRuns):
        return separate_runs.reasons(comparison)
    if not comparison.comparisons:
        found = "".join(f"; {words}" for words in comparison.differences.values())
        return [
            f"{comparison.run} and {comparison.baseline} share no episode of a policy of the same name{found}; play "
            "the same tasks with the same seeds and protocol, or compare two policies: RUN:A RUN:B"
        ]
    lines = []
    for kind, words in comparison.differences.items():
        remedy = "(allowed)" if kind in comparison.allowed else f"(compare all the same: --allow {kind})"
        lines.append(f"{kind} differs: {words} {remedy}")
    if comparison.verdict is Verdict.NOT_COMPARABLE:
        return lines
    for one in comparison.comparisons:
        lines += [*_found(one, comparison), *_moved(one, comparison.alpha)]
    for name, (now, before) in comparison.errors.items():
        lines.append(f"{name}: {counted(now, 'error')} (baseline: {before:,}), excluded from rates")
    for name, (now, before) in comparison.unpaired.items():
        lines.append(
            f"{name}: {counted(now, 'episode')} of the run and {before:,} of the baseline have no counterpart "
            "and are left out"
        )
    return lines


def _found(one: PolicyComparison, comparison: RunComparison) -> Iterator[str]:
    alpha, whole, policy = comparison.alpha, one.overall, one.first.policy
    episodes = counted(whole.pairs.trials, "episode")
    changed = [line for line in one.contrasts if least_p(line) <= alpha]
    for line in changed:
        yield f"{policy}, {line.task or pairwise.ALL}: {outcome(line)}, p {p_value(least_p(line))}"
    if not changed and not one.differing and one.is_same_policy:
        yield f"{policy}: the same policy, the same actions in all of {episodes}"
        return
    if not changed:
        drop = NOTHING if whole.detectable is None else f"{100 * whole.detectable:.1f} points"
        yield f"{policy}: {outcome(whole)}; a drop of {drop} over all tasks would be shown in four of five cases"
    if one.is_same_policy and one.differing:
        yield (
            f"{policy}: not changed, but other actions in {one.differing:,} of {episodes}: "
            f"{_why(*comparison.processors)}"
        )
    if comparison.margin is not None and not any(line.adjusted <= alpha for line in changed):
        is_shown = "is shown" if whole.no_worse else "is not shown"
        yield f"{policy}: {is_shown} to be no worse by more than {100 * comparison.margin:g} points"


def least_p(line: Contrast) -> float:
    """The adjusted p-value of being worse or of being better, whichever is less."""
    return min(line.adjusted, 1.0 if line.opposite is None else line.opposite)


def outcome(line: Contrast) -> str:
    """The rates in both runs, the number of episodes and the difference."""
    return f"{rates(line.pairs)} of {counted(line.pairs.trials, 'episode')}, {difference(line.difference)}"


def _moved(one: PolicyComparison, alpha: float) -> Iterator[str]:
    """How it moves and fails otherwise than before, unless all its actions are the same."""
    if one.behaviour is not None and (one.differing or not one.is_same_policy):
        yield from (
            f"{one.first.policy}: {line}" for line in paired_behaviour.sentences(one.behaviour, NOW, BEFORE, alpha)
        )


def behaviour_tables(one: PolicyComparison) -> list[TextTable]:
    """How a policy moves and fails in both runs; none where that was not measured."""
    is_alike = one.is_same_policy and not one.differing
    return [] if is_alike else paired_behaviour.tables(one.behaviour, NOW, BEFORE)


def _why(processor: str, before: str) -> str:
    """The possible cause of different actions of the same policy."""
    short, long = sorted((processor, before), key=len)
    # Older runs have the name only, without family and model.
    if short and processor != before and not long.startswith(f"{short} (family "):
        return f"the processor ({before} before, {processor} now) or the program changed"
    return "the program or a library changed"


def rates(pairs: Pairs) -> str:
    """`85 % before, 71 % now`."""
    return f"{percent(rate(pairs.second, pairs.trials))} before, {percent(rate(pairs.first, pairs.trials))} now"


def table(one: PolicyComparison, alpha: float) -> TextTable:
    """The tasks of a policy, and all tasks."""
    header = ("task", "pairs", "before", "now", "difference", "lost", "won", "p worse", "p better", "")
    return TextTable(header, tuple(_row(line, alpha) for line in one.contrasts), 1)


def tables(comparison: RunComparison) -> list[tuple[str, list[TextTable]]]:
    """The tables of each policy, with a title."""
    if isinstance(comparison, SeparateRuns):
        return separate_runs.tables(comparison)
    alpha = comparison.alpha
    return [(one.first.policy, [table(one, alpha), *behaviour_tables(one)]) for one in comparison.comparisons]


def _row(line: Contrast, alpha: float) -> tuple[str, ...]:
    pairs = line.pairs
    better = 1.0 if line.opposite is None else line.opposite
    effect = "worse" if line.adjusted <= alpha else "better" if better <= alpha else ""
    return (
        line.task or pairwise.ALL,
        f"{pairs.trials:,}",
        percent(rate(pairs.second, pairs.trials)),
        percent(rate(pairs.first, pairs.trials)),
        points(line.difference),
        f"{pairs.second_only:,}",
        f"{pairs.first_only:,}",
        p_value(line.adjusted),
        p_value(better),
        effect,
    )


def render(comparison: Comparison, form: str = "text") -> str:
    """A comparison in a format: `text`, `markdown` or `json`."""
    if form == "json":
        return as_json(comparison)
    if isinstance(comparison, PolicyComparisons):
        return pairwise.written(comparison, form)
    assert isinstance(comparison, RunComparison)
    return as_markdown(comparison) if form == "markdown" else as_text(comparison)


def as_text(comparison: RunComparison) -> str:
    """The headline and the reasons, for a log."""
    return "\n".join([headline(comparison), *(f"- {line}" for line in reasons(comparison))]) + "\n"


def as_markdown(comparison: RunComparison) -> str:
    """The result for a comment on a pull request."""
    mark = {Verdict.REGRESSED: "❌", Verdict.NOT_COMPARABLE: "⚠️", Verdict.SEPARATE: "ℹ️"}.get(comparison.verdict, "✅")
    parts = [f"### {mark} {escape(headline(comparison))}", ""]
    parts += [f"- {escape(line)}" for line in reasons(comparison)]
    for title, shown in tables(comparison):
        parts += ["", f"<details><summary>{escape(title)}</summary>"]
        parts += [text for one in shown for text in ("", markdown(one))]
        parts += ["", "</details>"]
    return "\n".join([*parts, "", method(comparison), ""])


def method(comparison: RunComparison) -> str:
    """How the numbers were computed."""
    if isinstance(comparison, SeparateRuns):
        return separate_runs.method(comparison)
    return (
        "Same seeds, paired episode by episode; exact McNemar test per task and over all tasks, adjusted together "
        f"(Holm); intervals of {100 * (1 - 2 * comparison.alpha):g} % (Newcombe). A run without a change is called "
        f"worse at most {100 * comparison.alpha:g} times in 100."
    )


def as_json(comparison: Comparison) -> str:
    """The result for programs; differences and their intervals are shares, between -1 and 1."""
    plain = asdict(comparison) | {"kind": comparison.kind}
    if isinstance(comparison, RunComparison):
        told = {"headline": headline(comparison), "reasons": reasons(comparison)}
        plain |= told | {"allowed": sorted(comparison.allowed)}
    elif isinstance(comparison, PolicyComparisons):
        for found, one in zip(plain["comparisons"], comparison.comparisons, strict=True):
            found |= {"headline": pairwise.headline(one), "sentences": pairwise.sentences(one, comparison)}
        for found, apart in zip(plain["unpaired"], comparison.unpaired, strict=True):
            found |= {"headline": pairwise.headline(apart), "sentences": pairwise.sentences(apart, comparison)}
    return json.dumps(plain, indent=1, sort_keys=True, allow_nan=False) + "\n"
