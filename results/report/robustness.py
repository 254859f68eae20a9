"""Severity curves and delivered values as words: tables for `report.md` and `report.html`."""

from __future__ import annotations

import math

from results.report import text
from results.report.merging import points
from results.report.text import NOTHING, TextTable
from results.robustness import DeliveredCell, PolicyCurve, Robustness
from results.statistics.rates import Estimate
from results.statistics.severity import SeverityCurve
from suites.axes import AXES
from suites.vocabulary import Condition


def title(axis: str) -> str:
    """`noise (N1): sensor noise, dB PSNR`."""
    known = AXES.get(axis)
    return axis if known is None else f"{axis} ({known.code}): {known.title}, {known.unit}"


def short_title(axis: str) -> str:
    """`sensor noise (N1)`."""
    known = AXES.get(axis)
    return axis if known is None else f"{known.title} ({known.code})"


def summary(axis: str) -> str:
    """What the axis does, in a sentence or two."""
    known = AXES.get(axis)
    return "" if known is None else known.summary


def level(condition: Condition) -> str:
    """`4: 16 dB PSNR`, or `clean`."""
    known = AXES.get(condition.axis)
    if known is None:
        return str(condition)
    return f"{condition.severity}: {known.value(condition.severity):g} {known.unit}"


def judged(curve: SeverityCurve) -> tuple[tuple[float, Estimate], ...]:
    """Levels with their rates, those without any verdict left out."""
    return tuple((s, r) for s, r in zip(curve.levels, curve.rates, strict=True) if not math.isnan(r.value))


def of_axis(robustness: Robustness, axis: str) -> tuple[PolicyCurve, ...]:
    """The axis' curves."""
    return tuple(curve for curve in robustness.curves if curve.axis == axis)


def over_all(robustness: Robustness, axis: str) -> tuple[PolicyCurve, ...]:
    """One curve per policy, over all simulators of the run."""
    first: dict[str, PolicyCurve] = {}
    for curve in of_axis(robustness, axis):
        first.setdefault(curve.policy, curve)
    return tuple(first.values())


def curves_table(robustness: Robustness, axis: str) -> TextTable:
    """Success at each severity with its interval, and what the curve amounts to."""
    curves = of_axis(robustness, axis)
    levels = sorted({level for found in curves for level in found.curve.levels})
    shown = ("clean" if level == 0 else _level(axis, int(level)) for level in levels)
    header = ("policy", "simulator", *shown, "drop at the last", "area kept", "half lost at", "falls, p")
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
        severity(curve.half, curve.levels[-1]),
        NOTHING if curve.trend is None else ("<0.001" if curve.trend < 0.001 else f"{curve.trend:.3f}"),
    )


def _level(axis: str, severity: int) -> str:
    return f"{severity}: {AXES[axis].value(severity):g}" if axis in AXES else str(severity)


def rate(estimate: Estimate | None) -> str:
    """`82 % [74, 89]`."""
    if estimate is None or math.isnan(estimate.value):
        return NOTHING
    return (
        f"{text.percent(estimate.value)} {text.span(estimate.interval)}"
        if estimate.interval
        else text.percent(estimate.value)
    )


def number(estimate: Estimate | None) -> str:
    """`0.82 [0.74, 0.89]`."""
    if estimate is None or math.isnan(estimate.value):
        return NOTHING
    ends = estimate.interval
    return f"{estimate.value:.2f}" + (f" [{ends.low:.2f}, {ends.high:.2f}]" if ends else "")


def severity(estimate: Estimate | None, last: float) -> str:
    """`3.1 [2.6, >5]`: what is infinite is beyond the last level."""
    if estimate is None or math.isnan(estimate.value):
        return NOTHING
    ends = () if estimate.interval is None else (estimate.interval.low, estimate.interval.high)
    value, *shown = (f">{last:g}" if math.isinf(end) else f"{end:.1f}" for end in (estimate.value, *ends))
    return f"{value} [{', '.join(shown)}]" if shown else value


def delivered_table(robustness: Robustness) -> TextTable:
    """Per axis and severity: what was asked for, what each simulator delivered, and how far they are apart."""
    simulators = sorted({cell.simulator for row in robustness.delivered for cell in row.simulators})
    header = ("axis", "severity", "asked", *simulators, "apart")
    lines = []
    for row in robustness.delivered:
        cells = {cell.simulator: cell for cell in row.simulators}
        spread = NOTHING if row.spread is None else text.percent(row.spread)
        values = (_value(cells.get(name)) for name in simulators)
        lines.append((row.axis, str(row.severity), f"{row.asked:g} {row.unit}", *values, spread))
    return TextTable(header, tuple(lines), 1)


def _value(cell: DeliveredCell | None) -> str:
    if cell is None:
        return NOTHING
    return f"{cell.mean:.4g}" if cell.low == cell.high else f"{cell.mean:.4g} [{cell.low:.4g}, {cell.high:.4g}]"


def worlds(robustness: Robustness) -> str:
    """Whether perturbed episodes started from the clean world, in a sentence."""
    found = robustness.worlds
    compared = text.counted(found.compared, "episode") + " on axes that move nothing"
    if not found.compared:
        return "No episode on an axis that moves nothing has a clean one of its task and seed to be compared with."
    if found.differing:
        return f"{found.differing:,} of {compared} started from another physical state than the clean episode."
    return f"All of {compared} started from the physical state of the clean episode."


def controls_table(robustness: Robustness) -> TextTable:
    """Per policy and simulator: success clean and under each control, and what is lost there."""
    names = tuple(dict.fromkeys(row.control for row in robustness.controls))
    header = ["policy", "simulator", "clean"]
    for name in names:
        header += [AXES[name].title, "lost"]
    found = {(row.policy, row.simulator, row.control): row for row in robustness.controls}
    lines = []
    for policy, simulator in dict.fromkeys((row.policy, row.simulator) for row in robustness.controls):
        rows = [found.get((policy, simulator, name)) for name in names]
        cells = [policy, simulator or "all", rate(next(row for row in rows if row is not None).clean)]
        for row in rows:
            cells += [rate(row.rate), points(row.drop)] if row else [NOTHING, NOTHING]
        lines.append(tuple(cells))
    return TextTable(tuple(header), tuple(lines), 2)


def unsupported_table(robustness: Robustness) -> TextTable:
    """Axes that tasks of the suite cannot have."""
    lines = tuple((short_title(gap.axis), gap.task, gap.reason) for gap in robustness.unsupported)
    return TextTable(("axis", "task", "why not"), lines, 3)


def gate_table(robustness: Robustness) -> TextTable:
    """Conditions in which the gate did not solve every seed."""
    lines = tuple(
        (
            row.task,
            "clean" if not row.severity else f"{row.axis}@{row.severity}",
            text.count(row.seeds),
            text.count(row.seeds - row.passed),
            "level left out" if row.capped else "seeds left out",
        )
        for row in robustness.gated
    )
    return TextTable(("task", "condition", "seeds", "not solved", "so"), lines, 2)


def gate(robustness: Robustness) -> str:
    """What the gate did, in a sentence."""
    if robustness.gate is None:
        return "No oracle gates these numbers: whether a perturbed episode can be solved at all was not tested."
    if not robustness.gated:
        return f"{robustness.gate} solved every seed under every condition."
    return f"Seeds that {robustness.gate} did not solve are left out for all policies and levels alike."
