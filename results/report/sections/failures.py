"""How policies fail: kinds of failures by condition, or by task."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from robogauntlet.results.analysis.failures import (
    COLUMNS,
    COMBINATIONS,
    FailureGroup,
    Failures,
    KindCount,
    PolicyFailures,
    build_failures,
)
from robogauntlet.results.record import FailureKind
from robogauntlet.results.report.blocks import (
    Bar,
    Block,
    Fold,
    Heading,
    Legend,
    Paragraph,
    Segment,
    Sentences,
    StackedBars,
    Table,
    Terms,
)
from robogauntlet.results.report.facts import DEFINITIONS, PHRASES
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, counted, percent, short_task, span
from robogauntlet.results.report.section import Page, Section
from robogauntlet.suites.episode import CLEAN

LONG = 6
"""Policies and simulators beyond which each is folded."""


def sentences(failures: Failures) -> list[str]:
    """Each policy's most frequent kind in a simulator, and where it fails most often; in one sentence, who never fails.

    Those with the most failures come first.
    """
    found = [_sentence(one, failures.by_task) for one in _sorted(failures.policies) if one.total.failures]
    others = [one for one in failures.policies if not one.total.failures]
    if others:
        names = ", ".join(
            f"{one.policy} in {one.simulator} ({counted(one.total.episodes, 'episode')})" for one in others
        )
        found.append(f"No failure: {names}.")
    return found


def _sentence(one: PolicyFailures, by_task: bool) -> str:
    start, total = f"{one.policy} in {one.simulator}", one.total
    if total.most is None:
        return f"{start}: {counted(total.failures, 'failure')}, none with a known kind."
    found = f"{start}: in {total.most.failures:,} of {counted(total.failures, 'failure')} {_did(total.most)}"
    parts = [group for group in one.groups if group.name != COMBINATIONS] or one.groups
    worst = max(parts, key=lambda group: group.failures)
    tied = sum(group.failures == worst.failures for group in parts) > 1
    if len(one.groups) < 2 or tied or worst.most is None:
        return f"{found}."
    where = f"on {short_task(worst.name)}" if by_task else _under(worst.name)
    did = "" if worst.most.kind == total.most.kind else f" {_did(worst.most)}"
    return f"{found}; {where}, which has the most failures, in {worst.most.failures:,} of {worst.failures:,}{did}."


def _under(name: str) -> str:
    return "in clean episodes" if name == CLEAN else f"under {name}"


def _did(kind: KindCount) -> str:
    return f"the robot {PHRASES[FailureKind(kind.kind)]} ({kind.kind})"


def failure_table(failures: Failures, one: PolicyFailures) -> TextTable:
    """The groups of a policy: episodes, failures, and for each kind their number and share of the failures."""
    kinds = [kind.kind for kind in one.total.kinds]
    header = ("task" if failures.by_task else "condition", "episodes", "failures", *kinds, "errors")
    groups = (*one.groups, one.total) if len(one.groups) > 1 else one.groups
    return TextTable(header, tuple(_row(group, kinds, by_task=failures.by_task) for group in groups), 1)


def _row(group: FailureGroup, kinds: Sequence[str], *, by_task: bool) -> tuple[str, ...]:
    found = {one.kind: one for one in group.kinds}
    shown = (
        f"{count(k.failures)}: {percent(k.share)} {span(k.interval)}" if (k := found.get(kind)) else NOTHING
        for kind in kinds
    )
    name = short_task(group.name) if by_task else group.name
    return (name, count(group.episodes), count(group.failures), *shown, count(group.errors))


def outcome_bars(failures: Failures, one: PolicyFailures) -> StackedBars:
    """The outcomes of all episodes of each group."""
    return StackedBars("outcome", tuple(_bar(one, group, failures) for group in one.groups))


def _bar(one: PolicyFailures, group: FailureGroup, failures: Failures) -> Bar:
    segments, start = [], 0.0
    for outcome in failures.outcomes:
        episodes = group.count(outcome)
        if episodes:
            width = 100 * episodes / group.episodes
            text = f"{outcome}: {episodes:,} of {counted(group.episodes, 'episode')}"
            segments.append(Segment(outcome, round(start, 3), round(width, 3), text))
            start += width
    name = short_task(group.name) if failures.by_task else group.name
    label = f"{one.policy} in {one.simulator}, {name}: {'; '.join(segment.text for segment in segments)}"
    return Bar(name, counted(group.episodes, "episode"), tuple(segments), label)


def _blocks(found: Failures, page: Page) -> Iterator[Block]:
    groups = "by task" if found.by_task else "by condition: the severities of an axis together"
    yield Paragraph(
        f"All episodes by outcome, {groups}. All episodes count except those of controls; an oracle gate rejects none "
        "of them."
    )
    yield Sentences(tuple(sentences(found)))
    yield Terms({kind: DEFINITIONS[kind] for kind in found.kinds})
    yield Legend(found.outcomes, "outcome")
    failed = [one for one in _sorted(found.policies) if one.total.failures]
    for one in failed:
        name = f"{one.policy}, {one.simulator}"
        table = Table(failure_table(found, one), f"{name}: kinds of failures")
        inner = (
            outcome_bars(found, one),
            Fold("Numbers, and shares of the failures with 95 % intervals", (table,), title=""),
        )
        if len(failed) > LONG:
            yield Fold(name, inner)
        else:
            yield Heading(name, one.policy)
            yield from inner


def _sorted(policies: Iterable[PolicyFailures]) -> list[PolicyFailures]:
    """Those with the most failures first."""
    return sorted(policies, key=lambda one: -one.total.failures)


SECTIONS = (
    Section(
        name="failures",
        title="How it fails",
        columns=COLUMNS,
        build=lambda source: build_failures(source.document, source.rows),
        type=Failures,
        blocks=_blocks,
        sentences=sentences,
    ),
)
