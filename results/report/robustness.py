"""Tables and sentences about robustness for `report.md` and `report.html`."""

from __future__ import annotations

import math

from robogauntlet.results.analysis.robustness import DeliveredCell, PolicyCurve, Robustness
from robogauntlet.results.analysis.robustness_summary import AgreementRow, RobustnessSummary, SummaryRow
from robogauntlet.results.report import formatting
from robogauntlet.results.report.formatting import NOTHING, TextTable, number, p_value, points, rate
from robogauntlet.results.statistics.multiplicity import ALPHA, holm
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.results.statistics.severity import SeverityCurve
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CLEAN, Condition


def axis_heading(axis: str) -> str:
    """An axis with its unit, `noise (dB PSNR)`."""
    return f"{axis} ({AXES[axis].unit})" if axis in AXES else axis


def axis_summary(axis: str) -> str:
    """Describe an axis in one or two sentences."""
    return AXES[axis].summary if axis in AXES else ""


def severity_text(condition: Condition) -> str:
    """A severity with its level, `4: 18.4 dB PSNR`, or `clean`."""
    axis = AXES.get(condition.axis)
    return str(condition) if axis is None else f"{condition.severity}: {axis.describe(condition.severity)}"


def known_rates(curve: SeverityCurve) -> tuple[tuple[float, Estimate], ...]:
    """Severities with their rates; those without a verdict are left out."""
    return tuple((s, r) for s, r in zip(curve.levels, curve.rates, strict=True) if not math.isnan(r.value))


def axis_curves(robustness: Robustness, axis: str) -> tuple[PolicyCurve, ...]:
    """The curves along an axis."""
    return tuple(curve for curve in robustness.curves if curve.axis == axis)


def overall_curves(robustness: Robustness, axis: str) -> tuple[PolicyCurve, ...]:
    """One curve per policy along an axis, over all simulators of the run."""
    first: dict[str, PolicyCurve] = {}
    for curve in axis_curves(robustness, axis):
        first.setdefault(curve.policy, curve)
    return tuple(first.values())


def curves_table(robustness: Robustness, axis: str) -> TextTable:
    """Success at each severity with its interval, and the statistics of each curve."""
    curves = axis_curves(robustness, axis)
    levels = sorted({level for found in curves for level in found.curve.levels})
    shown = ("clean" if level == 0 else _level(axis, int(level)) for level in levels)
    header = ("policy", "simulator", *shown, "drop at the last severity", "area kept", "half lost at", "trend p")
    return TextTable(header, tuple(_line(found, levels) for found in curves), 2)


def _line(found: PolicyCurve, levels: list[float]) -> tuple[str, ...]:
    curve = found.curve
    rates = dict(zip(curve.levels, curve.rates, strict=True))
    return (
        found.policy,
        found.simulator or "all",
        *(rate(rates.get(level)) for level in levels),
        NOTHING if math.isnan(curve.drops[-1].value) else points(curve.drops[-1]),
        number(curve.area),
        half_lost_text(curve.half, curve.levels[-1]),
        NOTHING if curve.trend is None else p_value(curve.trend),
    )


def _level(axis: str, severity: int) -> str:
    return f"{severity}: {AXES[axis].value(severity):g}" if axis in AXES else str(severity)


def half_lost_text(severity: float | None, last: float) -> str:
    """A severity such as `3.1`, or `>5`: beyond the last level."""
    if severity is None or math.isnan(severity):
        return NOTHING
    return f">{last:g}" if math.isinf(severity) else f"{severity:.1f}"


def delivered_table(robustness: Robustness) -> TextTable:
    """Requested and delivered value per axis and severity, and the spread of simulators."""
    simulators = sorted({cell.simulator for row in robustness.delivered for cell in row.simulators})
    header = ("axis", "severity", "requested", *simulators, "spread")
    lines = []
    for row in robustness.delivered:
        cells = {cell.simulator: cell for cell in row.simulators}
        spread = NOTHING if row.spread is None else formatting.percent(row.spread)
        values = (_value(cells.get(name)) for name in simulators)
        lines.append((row.axis, str(row.severity), AXES[row.axis].describe(row.severity), *values, spread))
    return TextTable(header, tuple(lines), 1)


def _value(cell: DeliveredCell | None) -> str:
    if cell is None:
        return NOTHING
    value = f"{cell.mean:.4g}" if cell.low == cell.high else f"{cell.mean:.4g} [{cell.low:.4g}, {cell.high:.4g}]"
    return f"{value}; nothing in {cell.undelivered:,} of {cell.episodes:,}" if cell.undelivered else value


def start_states_sentence(robustness: Robustness) -> str:
    """A sentence on whether perturbed episodes started from the state of the clean ones."""
    found = robustness.start_states
    compared = formatting.counted(found.compared, "episode") + " on axes that keep the start state"
    if not found.compared:
        return "Start states were not compared: no perturbed episode has a clean episode of the same task and seed."
    if found.differing:
        return f"{found.differing:,} of {compared} started from a physical state other than that of the clean episode."
    return f"All {compared} started from the physical state of the clean episode."


def unsupported_table(robustness: Robustness) -> TextTable:
    """Axes that tasks of the suite do not support."""
    lines = tuple((gap.axis, gap.task, gap.reason) for gap in robustness.unsupported)
    return TextTable(("axis", "task", "reason"), lines, 3)


def gate_table(robustness: Robustness) -> TextTable:
    """Conditions in which the oracle gate did not solve every seed."""
    lines = []
    for row in robustness.gate_rows:
        condition = str(Condition(row.axis, row.severity)) if row.severity else CLEAN
        counts = formatting.count(row.seeds), formatting.count(row.seeds - row.passed)
        lines.append((row.task, condition, *counts, "level left out" if row.capped else "seeds left out"))
    return TextTable(("task", "condition", "seeds", "not solved", "consequence"), tuple(lines), 2)


def oracle_gate_sentence(robustness: Robustness) -> str:
    """A sentence on the oracle gate."""
    if robustness.oracle_gate is None:
        return "There is no oracle gate: no script was tried on the perturbed episodes."
    if not robustness.gate_rows:
        return f"The oracle gate {robustness.oracle_gate} solved every seed under every condition."
    gate = robustness.oracle_gate
    sentence = f"Seeds that the oracle gate {gate} did not solve are left out for all policies and levels."
    for row in robustness.gated:
        left_out, won = row.episodes - row.counted, row.successes - row.counted_successes
        played = f"{row.successes:,} of {formatting.counted(row.episodes, 'perturbed episode')}"
        counted = f"{row.counted_successes:,} of the {row.counted:,} that count"
        sentence += f" {row.policy} succeeds in {played}, in {counted}, and in {won:,} of the {left_out:,} left out."
    return sentence


def summary_table(summary: RobustnessSummary) -> TextTable:
    """Mean success over all levels and the worst axis, per policy and simulator."""
    header = ("policy", "simulator", "mean", "worst axis", "its rate", "levels")
    return TextTable(header, tuple(_summary_line(row) for row in summary.rows), 2)


def _summary_line(row: SummaryRow) -> tuple[str, ...]:
    mean, worst = map(formatting.percent, (row.mean, row.worst))
    return (row.policy, row.simulator or "all", mean, row.worst_axis, worst, formatting.count(row.conditions))


def agreement_table(summary: RobustnessSummary) -> TextTable:
    """Agreement of simulators on the order of axes by loss."""
    header = ("policy", "simulators", "Kendall's tau", "p", "MMRV", "axes")
    return TextTable(header, tuple(_agreement(row) for row in summary.agreement), 2)


def _agreement(row: AgreementRow) -> tuple[str, ...]:
    tau = NOTHING if row.tau is None else f"{row.tau:.2f}"
    p = NOTHING if row.p is None else p_value(row.p)
    return (row.policy, f"{row.one}, {row.other}", tau, p, f"{100 * row.violation:.1f}", formatting.count(row.axes))


def agreement_findings(summary: RobustnessSummary) -> list[str]:
    """One or two sentences per policy: simulators whose orders of axes agree significantly, and the others."""
    sentences = []
    for policy in dict.fromkeys(row.policy for row in summary.agreement):
        rows = [row for row in summary.agreement if row.policy == policy]
        adjusted = holm([1.0 if row.p is None else row.p for row in rows])
        shown = [row for row, p in zip(rows, adjusted, strict=True) if p <= ALPHA]
        if shown:
            parts = [f"{row.one} and {row.other} (tau {row.tau:.2f})" for row in shown]
            sentences.append(f"{policy}: {', '.join(parts)} order the axes alike by success lost.")
        if len(shown) < len(rows):
            pairs = ", ".join(f"{row.one} and {row.other}" for row in rows if row not in shown)
            sentences.append(f"{policy}: agreement on the order of axes was not shown between {pairs}.")
    return sentences
