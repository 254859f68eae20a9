"""How policies fail, as sentences, tables and bars for `report.md`, `report.html` and the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from robogauntlet.results.analysis.failures import (
    COMBINATIONS,
    FailureGroup,
    Failures,
    KindCount,
    PolicyFailures,
)
from robogauntlet.results.record import FailureKind
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, counted, percent, short_task, span
from robogauntlet.suites.episode import CLEAN

PHRASES = {
    FailureKind.UNSAFE: "pressed against something that is not part of the task",
    FailureKind.NOT_REACHED: "never reached the object or the goal",
    FailureKind.NOT_GRASPED: "reached the object but never held it",
    FailureKind.NOT_MOVED: "reached the object but did not move it",
    FailureKind.DROPPED: "lost the object far from the goal",
    FailureKind.MISPLACED: "brought the object, or the tool, elsewhere than to the goal, or did not keep it there",
    FailureKind.TIMED_OUT: "came closer to the object, or to the goal, until time was up",
}
"""What the robot did in failures of each kind."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of a bar; positions are percentages of its width."""

    outcome: str
    start: float
    width: float
    episodes: int
    text: str
    """`dropped: 6 of 30 episodes`."""


@dataclass(frozen=True, slots=True)
class Bar:
    """The outcomes of all episodes of a group."""

    name: str
    episodes: int
    segments: tuple[Segment, ...]


def sentences(failures: Failures) -> list[str]:
    """A sentence for each policy and simulator: its most frequent kind, also where it fails most often."""
    return [_sentence(one, failures.by_task) for one in failures.policies]


def _sentence(one: PolicyFailures, by_task: bool) -> str:
    start, total = f"{one.policy} in {one.simulator}", one.total
    if not total.failures:
        return f"{start}: no failure in {counted(total.episodes, 'episode')}."
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


def bars(failures: Failures, one: PolicyFailures) -> list[Bar]:
    """The outcomes of all episodes of each group as a stacked bar."""
    return [_bar(short_task(group.name) if failures.by_task else group.name, group, failures) for group in one.groups]


def _bar(name: str, group: FailureGroup, failures: Failures) -> Bar:
    segments, start = [], 0.0
    for outcome in failures.outcomes:
        episodes = group.count(outcome)
        if episodes:
            width = 100 * episodes / group.episodes
            text = f"{outcome}: {episodes:,} of {counted(group.episodes, 'episode')}"
            segments.append(Segment(outcome, round(start, 3), round(width, 3), episodes, text))
            start += width
    return Bar(name, group.episodes, tuple(segments))
