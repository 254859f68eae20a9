"""Success under perturbations, compared with the clean condition."""

from __future__ import annotations

from collections.abc import Iterator

from robogauntlet.results.analysis.condition_comparison import ConditionComparison, Interaction
from robogauntlet.results.analysis.robustness import COLUMNS, PolicyCurve, Robustness, build_robustness, is_perturbed
from robogauntlet.results.report import condition_comparison as compared, robustness as words
from robogauntlet.results.report.blocks import (
    Block,
    Charts,
    Fold,
    Heading,
    HeatCell,
    HeatMap,
    IntervalPlot,
    Legend,
    Line,
    LineChart,
    Mark,
    Paragraph,
    Point,
    Sentences,
    Strips,
    Table,
    Terms,
    Videos,
)
from robogauntlet.results.report.facts import DEFINITIONS
from robogauntlet.results.report.findings import findings
from robogauntlet.results.report.formatting import NOTHING, TextTable, percent, points, rate, short_task, span
from robogauntlet.results.report.media import Video
from robogauntlet.results.report.section import Page, Section, Source
from robogauntlet.results.statistics.rates import Interval


def _terms(*names: str) -> Terms:
    return Terms({name: DEFINITIONS[name] for name in names})


def _blocks(found: Robustness, page: Page) -> Iterator[Block]:
    if found.axes or found.condition_comparison is not None:
        yield Heading("Findings")
        yield Sentences(findings(found))
        yield _terms("findings", "heat map")
        yield from _maps(found)
        yield from _all_axes(found)
        if found.condition_comparison is not None:
            yield from _comparison(found.condition_comparison)
        yield from _curves(found, page)
    yield from _checks(found)


def _maps(found: Robustness) -> Iterator[Block]:
    for maps in compared.heat_map_groups(found, no_skill_baselines=False):
        yield _heat_map(maps)
    for maps in compared.heat_map_groups(found, no_skill_baselines=True):
        yield Fold(f"{', '.join(one.policy for one in maps)} (no-skill baselines)", (_heat_map(maps),), title="")


def _heat_map(maps: tuple[compared.PolicyMap, ...]) -> HeatMap:
    """Maps of policies with equal rows, side by side."""
    simulators, columns = maps[0].columns, tuple(name for one in maps for name in one.columns)
    rows = tuple(
        (same[0][0], tuple(_heat_cell(cell) for _, cells in same for cell in cells))
        for same in zip(*(one.rows for one in maps), strict=True)
    )
    lines = tuple((one.policy, name, *map(_cell_text, cells)) for one in maps for name, cells in one.rows)
    groups = tuple((one.policy, len(one.columns), one.policy) for one in maps)
    label = f"{', '.join(one.policy for one in maps)}: success under every condition in each simulator"
    title = "Success under all conditions, and numbers of episodes"
    table = TextTable(("policy", "condition", *simulators), lines, 2)
    return HeatMap(label, "condition", columns, rows, groups, title, table, "heat-map")


def _cell_text(cell: compared.Cell | None) -> str:
    return NOTHING if cell is None else f"{rate(cell[0])}, {cell[1]}"


def _heat_cell(cell: compared.Cell | None) -> HeatCell:
    if cell is None:
        return HeatCell(0.0, "no result", kind="nothing")
    found, episodes = cell
    return HeatCell(found.value, percent(found.value), f"{span(found.interval)} n={episodes}")


def _all_axes(found: Robustness) -> Iterator[Block]:
    if found.summary is None or len(found.axes) < 2:
        return
    yield Heading("All axes together")
    yield _terms("all axes")
    yield Table(words.summary_table(found.summary), "All axes together, per policy and simulator")
    if found.summary.agreement:
        yield Heading("Agreement of simulators")
        yield _terms("agreement")
        yield Table(words.agreement_table(found.summary), "Agreement of simulators on the order of axes")


def _comparison(found: ConditionComparison) -> Iterator[Block]:
    yield Heading(f"Comparison with {found.baseline}")
    yield _terms("lost against", "lost beyond clean")
    if rule := compared.stopping_rule(found):
        yield Paragraph(rule)
    yield Charts(tuple(_losses(policy, found.baseline, rows) for policy, rows in compared.interactions_of(found)))
    yield Table(compared.interaction_table(found), "Success lost beyond the clean loss")
    yield Table(compared.loss_table(found), f"Success lost against {found.baseline}")
    if found.routers:
        yield Heading("Routers under perturbation")
        yield Table(compared.router_table(found), "Router accuracy beside success at every level")


def _losses(policy: str, baseline: str, rows: tuple[Interaction, ...]) -> IntervalPlot:
    marks = []
    for row in rows:
        at, text = compared.plot_position(row.extra.value), f"{row.axis}: {points(row.extra)}"
        marks.append((row.axis, Mark(at, _ends(row.extra.interval), _ends(row.corrected), text)))
    ticks = tuple((tick + 50, f"{tick:+d}" if tick else "0") for tick in (-50, -25, 0, 25, 50))
    label = f"{policy}: success lost beyond the clean loss, axis by axis"
    below = f"lost against {baseline} beyond clean (percentage points)"
    return IntervalPlot(policy, policy, label, tuple(marks), ticks, below, "losses")


def _ends(interval: Interval | None) -> tuple[float, float] | None:
    if interval is None:
        return None
    return compared.plot_position(interval.low), compared.plot_position(interval.high)


def _curves(found: Robustness, page: Page) -> Iterator[Block]:
    yield Heading("Curves")
    if subtracted := compared.no_skill_sentence(found):
        yield Paragraph(subtracted)
    yield _terms("severity curve", "area kept", "half lost at", "trend p")
    yield Legend(tuple(policy for policy in page.report.tables.policies if policy != found.oracle_gate))
    curves = {axis: words.overall_curves(found, axis) for axis in found.axes}
    yield Charts(tuple(_chart(axis, of_axis) for axis, of_axis in curves.items() if of_axis))
    for axis in found.axes:
        yield Heading(words.axis_heading(axis), anchor=f"axis-{axis}")
        if summary := words.axis_summary(axis):
            yield Paragraph(summary)
        if strips := page.media.strips.get(axis):
            named = ((one, tuple(words.severity_text(s.condition) for s in one.snapshots)) for one in strips)
            yield Strips(tuple(named))
        if words.axis_curves(found, axis):
            yield Table(words.curves_table(found, axis), f"{axis}: success by severity")
        else:
            yield Paragraph("No results with a clean condition to compare.")
        yield from _videos(axis, page)


def _chart(axis: str, curves: tuple[PolicyCurve, ...]) -> LineChart:
    last = max(found.curve.levels[-1] for found in curves)
    ticks = tuple((100 * level / last, str(level) if level else "clean") for level in range(int(last) + 1))
    lines = tuple(Line(found.policy, _points(found, last)) for found in curves)
    return LineChart(
        axis, f"{axis}: success by severity", lines, ticks, "severity", "success (%)", figure="success-by-severity"
    )


def _points(found: PolicyCurve, last: float) -> tuple[Point, ...]:
    made = []
    for level, estimate in words.known_rates(found.curve):
        ends = estimate.interval
        low, high = (None, None) if ends is None else (100 * ends.low, 100 * ends.high)
        text = f"{found.policy}, severity {level:g}: {rate(estimate)}"
        made.append(Point(100 * level / last, 100 * estimate.value, low, high, text))
    return tuple(made)


def _videos(axis: str, page: Page) -> Iterator[Block]:
    shown = sorted((one for one in page.media.new_failures if one.condition.axis == axis), key=lambda one: one.task)
    if not shown:
        return
    videos = Videos(tuple((one, _caption(one)) for one in shown))
    title = f"Recorded failures of episodes that succeed under the clean condition: {len(shown)}"
    yield Fold(title, (videos,))


def _caption(video: Video) -> str:
    outcome = f", {video.outcome}" if video.outcome != video.status else ""
    where = f"{short_task(video.task)}, seed {video.seed}, {words.severity_text(video.condition)}"
    return f"{video.policy}, {where}{outcome}"


def _checks(found: Robustness) -> Iterator[Block]:
    """What was checked of the perturbed episodes."""
    yield Heading("Repeated episodes")
    yield Paragraph(compared.repeats_sentence(found))
    yield Heading("Oracle gate")
    yield Paragraph(words.oracle_gate_sentence(found))
    if found.gate_rows:
        yield _terms("oracle gate")
        yield Table(words.gate_table(found), "Conditions in which the oracle gate did not solve every seed")
    if found.axes:
        yield Heading("Delivered perturbations")
        yield Paragraph(words.start_states_sentence(found))
        yield _terms("delivered")
        yield Table(words.delivered_table(found), "Delivered value of every severity by simulator")
    if found.unsupported:
        yield Heading("Unsupported")
        yield Table(words.unsupported_table(found), "Axes that tasks do not support")


def _sentences(source: Source) -> tuple[str, ...]:
    found = source.data.get("robustness")
    return findings(found) if found is not None else ()


SECTIONS = (
    Section(
        name="robustness",
        title="Robustness",
        columns=COLUMNS,
        applies=is_perturbed,
        build=lambda source: build_robustness(source.document, source.rows),
        type=Robustness,
        blocks=_blocks,
        sentences=findings,
        links=lambda found: [(f"axis-{axis}", axis) for axis in found.axes],
    ),
    Section("findings", "Findings", lambda found, page: (), _sentences, type=tuple[str, ...]),
)
