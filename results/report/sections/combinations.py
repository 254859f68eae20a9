"""Results under combinations of axes: which axes matter, and where failures gather."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from robogauntlet.results.analysis.combinations import (
    BINS,
    COLUMNS,
    Combinations,
    PairEffect,
    PolicyCombinations,
    build_combinations,
    is_inside,
)
from robogauntlet.results.report import formatting
from robogauntlet.results.report.blocks import (
    Block,
    Charts,
    Fold,
    Heading,
    HeatCell,
    HeatMap,
    IntervalPlot,
    Mark,
    Paragraph,
    Sentences,
    Table,
    Terms,
    Videos,
)
from robogauntlet.results.report.facts import DEFINITIONS
from robogauntlet.results.report.formatting import TextTable, p_value, percent, rate, span
from robogauntlet.results.report.media import Video
from robogauntlet.results.report.section import Page, Section
from robogauntlet.results.statistics.clusters import MOST_AXES, AxisCondition, Cluster
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.results.statistics.sensitivity import AxisSensitivity
from robogauntlet.suites.axes import AXES, SEVERITIES

GROUPS = ("absent", *(f"up to {highest}" for highest in range(1, BINS)))
"""Headings of the groups of severities; each begins where the one before it ends."""
MOST_NAMED = 3
FEW, MANY = 0.15, 0.95
"""Shares of successes beyond which a design is saturated."""


def sentences(one: PolicyCombinations, found: Combinations) -> tuple[str, ...]:
    """Return when a policy fails, why, how sure that is, and whether another design would show more."""
    return tuple(filter(None, (_when(one, found.axes), _why(one), _how_sure(one), _saturated(one, found))))


def _when(found: PolicyCombinations, axes: Sequence[str]) -> str:
    clean = f" (clean {rate(found.clean)})" if found.clean else ""
    start = (
        f"{found.policy} in {found.simulator} succeeds in {rate(found.success)} under combinations of {_listed(axes)}"
    )
    if not found.clusters:
        return f"{start}{clean}; no combination was shown to fail more often than the rest."
    first = found.clusters[0]
    where = f"where {condition_text(first)}, {rate(first.within)} of the episodes fail, elsewhere {rate(first.outside)}"
    return f"{start}{clean}; {where}."


def _why(found: PolicyCombinations) -> str:
    shown = [one for one in by_total(found) if _is_shown(one)]
    of_clusters = dict.fromkeys(condition.axis for cluster in found.clusters for condition in cluster.conditions)
    others = [axis for axis in of_clusters if axis not in {one.axis for one in shown}]
    if shown:
        parts = _listed([f"{one.axis} in {_share(one.total)}" for one in shown[:MOST_NAMED]])
        also = f"; the failure clusters also show {_listed(others)}" if others else ""
        return f"Why: of the differences in success that the axes cause, alone or together, {parts}{also}."
    reason = found.why_no_sensitivity or "the index of no axis is shown to be above 0"
    if not others:
        return f"Why: unknown, {reason}."
    return f"Why: {_listed(others)}, by the failure clusters; which share of the differences is unknown, {reason}."


def _is_shown(one: AxisSensitivity) -> bool:
    return one.total.interval is None or one.total.interval.low > 0


def _how_sure(found: PolicyCombinations) -> str:
    parts = []
    if found.clusters:
        first, *others = found.clusters
        worst = max(cluster.p_value for cluster in found.clusters)
        number = formatting.counted(len(found.clusters), "failure cluster")
        shown = f"p {'' if worst < 0.001 else 'at most '}{p_value(worst)}"
        halves = f"{first.discovery.episodes} and {first.confirmation.episodes} episodes"
        parts.append(
            f"{number} found on one half of the seeds and confirmed on the other ({shown}, all candidates together; "
            f"{'the first ' if others else ''}on {halves})"
        )
    if found.sensitivity is not None and found.sensitivity.explained is not None:
        share = _share(found.sensitivity.explained)
        parts.append(
            f"the axes explain {share} of the variance of one episode, the rest is its task, start state and chance"
        )
    if len(found.effects) > MOST_AXES:
        parts.append(f"failure clusters of two axes are left out, as there are more than {MOST_AXES} axes")
    left_out = {"base point": found.base_points_left_out, "start state": found.start_states_left_out}
    if any(left_out.values()):
        named = _listed([formatting.counted(number, noun) for noun, number in left_out.items() if number])
        parts.append(f"the indices leave out {named} with episodes without a verdict")
    if _first_is_open(by_total(found)):
        parts.append("which axis matters most is not shown")
    counts = f"{formatting.counted(found.episodes, 'episode')} at {formatting.counted(found.points, 'point')}"
    return f"How sure: {'; '.join([*parts, counts])}."


def _saturated(one: PolicyCombinations, found: Combinations) -> str:
    """Which design to play instead of one in which nearly all episodes fail, or nearly all succeed; else nothing."""
    few = one.success.value < FEW
    other = max(1.0, found.highest / 2) if few else min(float(SEVERITIES), 2 * found.highest)
    if FEW <= one.success.value <= MANY or other == found.highest:
        return ""
    outcome, kind = (
        (f"{percent(1 - FEW)} of the episodes fail", "milder")
        if few
        else (f"{percent(MANY)} of the episodes succeed", "harder")
    )
    return (
        f"Saturated: at least {outcome}, which tells little of the axes; play a {kind} design, with severities "
        f"up to {other:g} instead of {found.highest:g}."
    )


def _first_is_open(ranked: Sequence[AxisSensitivity]) -> bool:
    """Whether the interval of the largest total index meets another's. One without an interval is a point."""
    low = [one.total.interval.low if one.total.interval else one.total.value for one in ranked[:1]]
    high = [one.total.interval.high if one.total.interval else one.total.value for one in ranked[1:]]
    return bool(low and high) and max(high) >= low[0]


def _share(estimate: Estimate) -> str:
    return f"{percent(estimate.value)} {span(estimate.interval)}" if estimate.interval else percent(estimate.value)


def condition_text(cluster: Cluster) -> str:
    """Return the conditions of a cluster with their levels, `table is 3 or more (35 dE*ab of the mean colour)`."""
    return " and ".join(map(_threshold, cluster.conditions))


def _threshold(condition: AxisCondition) -> str:
    axis = AXES.get(condition.axis)
    level = f" ({axis.describe(condition.threshold)})" if axis is not None else ""
    return f"{condition.axis} is {condition.threshold} or more{level}"


def index_table(found: PolicyCombinations) -> TextTable:
    """Sobol' total index per axis, the largest first."""
    return TextTable(("axis", "total index"), tuple((one.axis, _share(one.total)) for one in by_total(found)), 1)


def by_total(found: PolicyCombinations) -> list[AxisSensitivity]:
    """Return the indices of the axes, the largest total first; none without indices."""
    indices = (found.sensitivity.axes if found.sensitivity is not None else None) or ()
    return sorted(indices, key=lambda one: -one.total.value)


def effect_table(found: PolicyCombinations) -> TextTable:
    """Success by severity of each axis, whatever the others are."""
    rows = tuple((effect.axis, *map(rate, effect.rates)) for effect in found.effects)
    return TextTable(("axis", *GROUPS), rows, 1)


def cluster_table(found: PolicyCombinations) -> TextTable:
    """Failure clusters, the highest lift first."""
    rows = tuple(
        (
            condition_text(cluster),
            rate(cluster.within),
            rate(cluster.outside),
            f"{cluster.lift:.1f}" if math.isfinite(cluster.lift) else "no failure elsewhere",
            f"{cluster.discovery.failures}/{cluster.discovery.episodes}",
            f"{cluster.confirmation.failures}/{cluster.confirmation.episodes}",
            p_value(cluster.p_value),
        )
        for cluster in found.clusters
    )
    return TextTable(("where", "failure", "elsewhere", "lift", "found on", "confirmed on", "p"), rows, 1)


def agreement_table(found: Combinations) -> TextTable:
    """Agreement of simulators on which axes matter."""
    rows = tuple(
        (one.policy, f"{one.one}, {one.other}", f"{one.tau:.2f}", p_value(one.p_value), formatting.count(one.axes))
        for one in found.agreement
    )
    return TextTable(("policy", "simulators", "tau", "p", "axes"), rows, 2)


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _blocks(found: Combinations, page: Page) -> Iterator[Block]:
    if not found.policies:
        return
    for one in found.policies:
        if len(found.policies) > 1:
            yield Heading(_name(one), one.policy)
        yield Sentences(sentences(one, found))
    design = f"Design: {found.design} over {', '.join(found.axes)}." if found.design else ""
    yield Paragraph(design or "Combinations that the suite lists.", is_note=True)
    yield Terms({term: DEFINITIONS[term] for term in ("sensitivity index", "failure cluster")})
    for one in found.policies:
        yield Heading(_name(one), one.policy)
        yield from _of_policy(one, page)
    if found.agreement:
        yield Heading("Agreement of simulators on axes")
        yield Terms({"agreement on axes": DEFINITIONS["agreement on axes"]})
        yield Table(agreement_table(found), "Agreement of simulators on which axes matter")


def _name(one: PolicyCombinations) -> str:
    return f"{one.policy}, {one.simulator}"


def _of_policy(one: PolicyCombinations, page: Page) -> Iterator[Block]:
    if by_total(one):
        yield Charts((_index_chart(one),))
        table = Table(index_table(one), f"{_name(one)}: sensitivity indices")
        yield Fold("Indices as numbers", (table,), title="")
    else:
        yield Paragraph(f"No sensitivity indices: {one.why_no_sensitivity}.")
    if one.clusters:
        yield Heading("Failure clusters", level=4)
        yield Table(cluster_table(one), f"{_name(one)}: failure clusters")
        shown = [
            (video, _caption(video))
            for video in page.media.new_failures
            if (video.policy, video.simulator) == (one.policy, one.simulator)
            and any(is_inside(video.condition, cluster) for cluster in one.clusters)
        ]
        if shown:
            yield Videos(tuple(shown))
    if one.pair:
        yield Heading(" and ".join(one.pair.axes), level=4)
        yield _pair_map(one.pair)
    yield Heading("Success by severity of each axis, whatever the others are", level=4)
    yield Table(effect_table(one), f"{_name(one)}: success by severity of each axis")


def _caption(video: Video) -> str:
    outcome = f", {video.outcome}" if video.outcome != video.status else ""
    return f"{formatting.short_task(video.task)}, seed {video.seed}, {video.condition}{outcome}"


def _index_chart(one: PolicyCombinations) -> IntervalPlot:
    rows = tuple((axis.axis, _mark(axis)) for axis in by_total(one))
    label = f"{_name(one)}: share of the variance of success in which each axis takes part"
    ticks = tuple((tick, str(tick)) for tick in (0, 25, 50, 75, 100))
    return IntervalPlot("", one.policy, label, rows, ticks, "share of the variance (%)", "sensitivity")


def _mark(axis: AxisSensitivity) -> Mark:
    ends = axis.total.interval
    interval = None if ends is None else (100 * ends.low, 100 * ends.high)
    return Mark(100 * axis.total.value, interval, None, f"{axis.axis}: {_share(axis.total)}")


def _pair_map(pair: PairEffect) -> HeatMap:
    rows = tuple(
        (group, tuple(_pair_cell(*cell) for cell in zip(rates, episodes, strict=True)))
        for group, rates, episodes in zip(GROUPS, pair.rates, pair.episodes, strict=True)
    )
    label = f"Success by severity of {pair.axes[0]} and {pair.axes[1]}"
    return HeatMap(label, pair.axes[0], GROUPS, rows, ((pair.axes[1], len(GROUPS), None),))


def _pair_cell(value: float | None, episodes: int) -> HeatCell:
    return HeatCell(0.0, "", kind="nothing") if value is None else HeatCell(value, percent(value), f"n={episodes}")


SECTIONS = (
    Section(
        name="combinations",
        title="Why it fails",
        columns=COLUMNS,
        build=lambda source: build_combinations(source.document, source.rows),
        type=Combinations,
        blocks=_blocks,
        sentences=lambda found: [sentence for one in found.policies for sentence in sentences(one, found)],
    ),
)
