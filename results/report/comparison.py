"""A comparison of two runs as text, Markdown, JSON and JUnit XML."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import asdict
from xml.etree import ElementTree

from robogauntlet.results.analysis.comparison import Comparison, Line, PolicyComparison, Verdict
from robogauntlet.results.report import paired_behaviour
from robogauntlet.results.report.formatting import NOTHING, TextTable, counted, escape, markdown, percent
from robogauntlet.results.statistics.pairs import Pairs
from robogauntlet.results.statistics.rates import Estimate, rate

MARKS = {
    Verdict.REGRESSED: "REGRESSED",
    Verdict.IMPROVED: "improved",
    Verdict.NO_EVIDENCE: "no evidence of a difference",
    Verdict.NOT_COMPARABLE: "NOT COMPARABLE",
}
BEGINS = re.compile(
    rf"(### \S+ )?({'|'.join(map(re.escape, MARKS.values()))}): [^\n]+ against "
    r"|\{\n \"allowed\": \["
    r"|<\?xml [^\n]*\?>\n<testsuite name=\"[^\n]* against ".encode()
)
"""How a comparison of two runs begins, in each of its forms."""
ALL = "all tasks"
NOW, BEFORE = "the run", "the baseline"


def headline(comparison: Comparison) -> str:
    """The verdict and the names of the runs."""
    return f"{MARKS[comparison.verdict]}: {comparison.run} against {comparison.baseline}"


def reasons(comparison: Comparison) -> list[str]:
    """The reasons of the verdict, a line each, with what the comparison can show."""
    if not comparison.policies:
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
    for one in comparison.policies:
        lines += _found(one, comparison)
        lines += _moved(one, comparison.alpha)
    for name, (now, before) in comparison.errors.items():
        lines.append(f"{name}: {counted(now, 'error')} (baseline: {before:,}), excluded from rates")
    for name, (now, before) in comparison.unpaired.items():
        lines.append(
            f"{name}: {counted(now, 'episode')} of the run and {before:,} of the baseline have no counterpart "
            "and are left out"
        )
    return lines


def _found(one: PolicyComparison, comparison: Comparison) -> Iterator[str]:
    alpha, whole = comparison.alpha, one.whole
    changed = [line for line in one.lines if min(line.p_worse, line.p_better) <= alpha]
    for line in changed:
        p = min(line.p_worse, line.p_better)
        yield (
            f"{one.policy}, {line.task or ALL}: {rates(line.pairs)} of {counted(line.pairs.trials, 'episode')}, "
            f"{points(line.difference)}, p {p_text(p)}"
        )
    if not changed and not one.differing and not one.changed:
        yield f"{one.policy}: the same policy, the same actions in all of {counted(whole.pairs.trials, 'episode')}"
        return
    if not changed:
        drop = NOTHING if whole.detectable is None else f"{100 * whole.detectable:.1f} points"
        yield (
            f"{one.policy}: {rates(whole.pairs)} of {counted(whole.pairs.trials, 'episode')}, "
            f"{points(whole.difference)}; a drop of {drop} over all tasks would be shown in four of five cases"
        )
    if not one.changed and one.differing:
        yield (
            f"{one.policy}: not changed, but other actions in {one.differing:,} of "
            f"{counted(whole.pairs.trials, 'episode')}: {_why(*comparison.processors)}"
        )
    if not any(line.p_worse <= alpha for line in changed):
        is_shown = "is shown" if one.no_worse else "is not shown"
        yield f"{one.policy}: {is_shown} to be no worse by more than {100 * comparison.margin:g} points"


def _moved(one: PolicyComparison, alpha: float) -> Iterator[str]:
    """How it moves and fails otherwise than before, unless all its actions are the same."""
    if one.behaviour is not None and (one.changed or one.differing):
        yield from (f"{one.policy}: {line}" for line in paired_behaviour.sentences(one.behaviour, NOW, BEFORE, alpha))


def behaviour_tables(one: PolicyComparison) -> list[TextTable]:
    """How a policy moves and fails in both runs; none where that was not measured."""
    found = one.behaviour
    if found is None or not (one.changed or one.differing):
        return []
    tables = [paired_behaviour.measure_table(found)] if found.measures else []
    return tables + ([paired_behaviour.change_table(found.changes, NOW, BEFORE)] if found.changes else [])


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


def points(estimate: Estimate | None) -> str:
    """A difference of rates in points with its interval: `-14.0 points [-22, -6]`."""
    if estimate is None:
        return NOTHING
    ends = estimate.interval
    shown = "" if ends is None else f" [{100 * ends.low:+.0f}, {100 * ends.high:+.0f}]"
    return f"{100 * estimate.value:+.1f} points{shown}"


def p_text(p: float) -> str:
    """A p-value: `<0.0001`, `0.0012` or `0.31`."""
    return "<0.0001" if p < 0.0001 else f"{p:.4f}" if p < 0.01 else f"{p:.2f}"


def table(one: PolicyComparison, alpha: float) -> TextTable:
    """The tasks of a policy, and all tasks."""
    header = ("task", "pairs", "before", "now", "difference", "lost", "won", "p worse", "p better", "")
    return TextTable(header, tuple(_row(line, alpha) for line in one.lines), 1)


def _row(line: Line, alpha: float) -> tuple[str, ...]:
    pairs = line.pairs
    effect = "worse" if line.p_worse <= alpha else "better" if line.p_better <= alpha else ""
    return (
        line.task or ALL,
        f"{pairs.trials:,}",
        percent(rate(pairs.second, pairs.trials)),
        percent(rate(pairs.first, pairs.trials)),
        points(line.difference),
        f"{pairs.second_only:,}",
        f"{pairs.first_only:,}",
        p_text(line.p_worse),
        p_text(line.p_better),
        effect,
    )


def as_text(comparison: Comparison) -> str:
    """The headline and the reasons, for a log."""
    return "\n".join([headline(comparison), *(f"- {line}" for line in reasons(comparison))]) + "\n"


def as_markdown(comparison: Comparison) -> str:
    """The result for a comment on a pull request."""
    mark = {Verdict.REGRESSED: "❌", Verdict.NOT_COMPARABLE: "⚠️"}.get(comparison.verdict, "✅")
    parts = [f"### {mark} {escape(headline(comparison))}", ""]
    parts += [f"- {escape(line)}" for line in reasons(comparison)]
    for one in comparison.policies:
        parts += ["", f"<details><summary>{escape(one.policy)}</summary>", "", markdown(table(one, comparison.alpha))]
        parts += [text for shown in behaviour_tables(one) for text in ("", markdown(shown))]
        parts += ["", "</details>"]
    return "\n".join([*parts, "", _method(comparison), ""])


def _method(comparison: Comparison) -> str:
    return (
        "Same seeds, paired episode by episode; exact McNemar test per task and over all tasks, adjusted together "
        f"(Holm); intervals of {100 * (1 - 2 * comparison.alpha):g} % (Newcombe). A run without a change is called "
        f"worse at most {100 * comparison.alpha:g} times in 100."
    )


def as_json(comparison: Comparison) -> str:
    """The result for programs."""
    plain = asdict(comparison) | {
        "allowed": sorted(comparison.allowed),
        "headline": headline(comparison),
        "reasons": reasons(comparison),
    }
    return json.dumps(plain, indent=1, sort_keys=True, allow_nan=False) + "\n"


def as_junit(comparison: Comparison) -> str:
    """A test case per policy and task in JUnit's format, which fails if the policy became worse."""
    suite = ElementTree.Element("testsuite", name=f"{comparison.run} against {comparison.baseline}")
    failures = 0
    for one in comparison.policies:
        for line in one.lines:
            case = ElementTree.SubElement(suite, "testcase", classname=one.policy, name=line.task or ALL)
            text = f"{rates(line.pairs)} of {counted(line.pairs.trials, 'episode')}, {points(line.difference)}"
            if comparison.verdict is Verdict.NOT_COMPARABLE:
                ElementTree.SubElement(case, "skipped", message="; ".join(comparison.differences.values()))
            elif line.p_worse <= comparison.alpha:
                failures += 1
                ElementTree.SubElement(case, "failure", message=f"{text}, p {p_text(line.p_worse)}")
            ElementTree.SubElement(case, "system-out").text = text
    if not comparison.policies:
        case = ElementTree.SubElement(suite, "testcase", classname="comparison", name="shared episodes")
        ElementTree.SubElement(case, "error", message=reasons(comparison)[-1])
    suite.set("tests", str(len(suite.findall("testcase"))))
    suite.set("failures", str(failures))
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


FORMATS = {"text": as_text, "json": as_json, "markdown": as_markdown, "junit": as_junit}
