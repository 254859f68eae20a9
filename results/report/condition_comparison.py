"""Tables, heat maps and sentences that compare policies under perturbations."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

from robogauntlet.results.analysis.condition_comparison import (
    ConditionComparison,
    Equivalence,
    Interaction,
    LossRow,
    Saving,
)
from robogauntlet.results.analysis.robustness import PolicyCurve, Robustness
from robogauntlet.results.report import formatting
from robogauntlet.results.report.formatting import NOTHING, TextTable, p_value, points, share
from robogauntlet.results.report.robustness import known_rates, overall_curves
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CLEAN, CONTROLS, Condition

REACH = 0.5
"""Half the range of a forest plot, a difference of rates."""


Cell = tuple[Estimate, int]
"""Success of a policy at a level in a simulator, and the number of episodes that count."""


@dataclass(frozen=True, slots=True)
class PolicyMap:
    """One policy's success, levels by simulators."""

    policy: str
    columns: tuple[str, ...]
    """Simulators, then `all` if there are several."""
    rows: tuple[tuple[str, tuple[Cell | None, ...]], ...]
    """Condition, and a cell per column; None where no episode counts."""


def heat_maps(robustness: Robustness) -> tuple[PolicyMap, ...]:
    """A heat map per policy, the clean condition first."""
    policies = dict.fromkeys(curve.policy for curve in robustness.curves)
    return tuple(_heat_map(robustness, policy) for policy in policies)


def heat_map_groups(robustness: Robustness, *, no_skill_baselines: bool) -> tuple[tuple[PolicyMap, ...], ...]:
    """Group the heat maps of no-skill baselines, or of the others, by simulators and conditions: each is one table."""
    groups: dict[tuple[tuple[str, ...], ...], list[PolicyMap]] = {}
    for found in heat_maps(robustness):
        if (found.policy in robustness.no_skill_baselines) is no_skill_baselines:
            groups.setdefault((found.columns, tuple(name for name, _ in found.rows)), []).append(found)
    return tuple(map(tuple, groups.values()))


def _heat_map(robustness: Robustness, policy: str) -> PolicyMap:
    of_policy = [curve for curve in robustness.curves if curve.policy == policy]
    places = sorted({curve.simulator for curve in of_policy}, key=lambda name: (name is None, name or ""))
    rows: dict[str, tuple[Cell | None, ...]] = {}
    for axis in robustness.axes:
        curves = {curve.simulator: curve for curve in of_policy if curve.axis == axis}
        for level in sorted({int(level) for curve in curves.values() for level in curve.curve.levels}):
            cells = tuple(_cell(curves.get(place), level) for place in places)
            rows.setdefault(condition_text(axis, level), cells)  # each axis has the clean level
    return PolicyMap(policy, tuple(place or "all" for place in places), tuple(rows.items()))


def _cell(curve: PolicyCurve | None, level: int) -> Cell | None:
    if curve is None or level not in curve.curve.levels:
        return None
    place = curve.curve.levels.index(level)
    return (curve.curve.rates[place], curve.episodes[place]) if curve.episodes[place] else None


def condition_text(axis: str, severity: int) -> str:
    """A condition with its level, `noise@4: 18.4 dB PSNR`; `clean` and controls have none."""
    if not severity:
        return CLEAN
    level = f": {AXES[axis].describe(severity)}" if axis in AXES and axis not in CONTROLS else ""
    return f"{Condition(axis, severity)}{level}"


def loss_table(comparison: ConditionComparison) -> TextTable:
    """Success lost against the baseline by each other policy at every level."""
    header = ("policy", "condition", comparison.baseline, "policy's", "lost", "p", "adjusted p", "e-value", "pairs")
    return TextTable(header, tuple(_loss_line(row) for row in comparison.losses), 2)


def _loss_line(row: LossRow) -> tuple[str, ...]:
    rates = (formatting.percent(row.baseline), formatting.percent(row.rate), points(row.loss))
    tests = (p_value(row.p), p_value(row.adjusted), e_value(row.evidence), formatting.count(row.pairs))
    return (row.policy, condition_text(row.axis, row.severity), *rates, *tests)


def e_value(value: float) -> str:
    """An e-value such as `0.3`, `24`, or `>1,000,000`."""
    return ">1,000,000" if value > 1e6 else (f"{value:,.0f}" if value >= 10 else f"{value:.2g}")


def stopping_rule(comparison: ConditionComparison) -> str | None:
    """Sentences on the rule that stopped conditions early, and its effect; None without a rule."""
    rule = comparison.rule
    if rule is None:
        return None
    text = (
        f"A condition stops when the e-value of {comparison.baseline} against every other policy, over all tasks, "
        f"reaches {1 / rule.alpha:g}, evaluated after every {formatting.counted(rule.round, 'seed')}; the probability "
        f"of deciding a comparison without a difference is at most {formatting.percent(rule.alpha)}. "
        f"Saved episodes go to undecided conditions, up to {formatting.counted(rule.max_seeds, 'seed')} each, in "
        "random order per round. "
    )
    parts = [
        f"{Condition(row.axis, row.severity)} after {formatting.counted(row.seeds, 'seed')} per task "
        f"({row.policy}, e-value {e_value(row.evidence)})"
        for row in comparison.decided
    ]
    text += f"Decided: {'; '.join(parts)}." if parts else "No condition was decided."
    return text + (f" {_saving(comparison.saving)}" if comparison.saving else "")


def _saving(saving: Saving) -> str:
    whole, spared, given = map(formatting.count, (saving.planned, saving.spared, saving.given))
    if not saving.spared:
        return f"All {whole} episodes of the suite were played."
    text = f"Of the suite's {whole} episodes, {spared} were not needed after their condition was decided; "
    if not saving.saved:
        return f"{text}as many were played in undecided conditions instead."
    share = formatting.percent(saving.saved / saving.planned)
    return (
        f"{text}{given} were played in undecided conditions instead, "
        f"and {formatting.count(saving.saved)} ({share}) not at all."
    )


def equivalence_sentence(found: Equivalence, baseline: str) -> str:
    """What a policy loses over all perturbed levels, and whether it is shown to be equivalent to the baseline."""
    is_shown = "is shown" if found.is_shown else "is not shown"
    interval = "90 % interval" if found.loss.interval else "no interval: the seeds of each task are alike"
    return (
        f"{found.policy}: {points(found.loss)} percentage points lost against {baseline} over all "
        f"{formatting.counted(found.levels, 'perturbed level')} ({interval}); that they differ by less than "
        f"{100 * found.margin:g} points {is_shown}."
    )


def interaction_table(comparison: ConditionComparison) -> TextTable:
    """Success lost under each axis beyond the clean loss."""
    header = ("policy", "axis", "lost beyond clean", "simultaneous interval", "tasks")
    lines = []
    for row in comparison.interactions:
        ends = row.corrected
        span = NOTHING if ends is None else f"[{100 * ends.low:.1f}, {100 * ends.high:.1f}]"
        lines.append((row.policy, row.axis, points(row.extra), span, formatting.count(row.tasks)))
    return TextTable(header, tuple(lines), 2)


def interactions_of(comparison: ConditionComparison) -> tuple[tuple[str, tuple[Interaction, ...]], ...]:
    """The interactions, policy by policy."""
    return tuple((policy, tuple(rows)) for policy, rows in groupby(comparison.interactions, key=lambda row: row.policy))


def plot_position(value: float) -> float:
    """Position of a difference of rates on a forest plot, from 0 to 100."""
    return 50 + 50 * max(-1.0, min(1.0, value / REACH))


def router_table(comparison: ConditionComparison) -> TextTable:
    """Router accuracy and success at every level."""
    lines = []
    for _, group in groupby(comparison.routers, key=lambda row: (row.policy, row.axis)):
        for row in group:
            condition = condition_text(row.axis, row.severity) if row.severity else f"clean ({row.axis})"
            rates = map(share, (row.right, row.success, row.misrouted))
            lines.append((row.policy, condition, *rates))
    header = ("policy", "condition", "router accuracy", "success", "success if misrouted")
    return TextTable(header, tuple(lines), 2)


def repeats_sentence(robustness: Robustness) -> str:
    """A sentence on whether repeated episodes were identical."""
    if not robustness.repeats:
        return "No clean episode was repeated (condition `again`): determinism was not tested."
    parts = [f"{row.identical:,} of {row.episodes:,} in {row.simulator}" for row in robustness.repeats]
    return f"Repeated clean episodes with bit-identical actions and final states: {', '.join(parts)}."


def no_skill_sentence(robustness: Robustness) -> str | None:
    """A sentence on what is subtracted before retention is computed; None without no-skill baselines."""
    if not robustness.no_skill_baselines:
        return None
    names = " or ".join(robustness.no_skill_baselines)
    return f"Success of {names} at the same level is subtracted before area kept and half lost are computed."


def worst_level(robustness: Robustness, policy: str) -> tuple[PolicyCurve, int] | None:
    """The curve and severity with the lowest success of a policy over all simulators; None of a single one."""
    found = [
        (estimate.value, -severity, curve)
        for axis in robustness.axes
        for curve in overall_curves(robustness, axis)
        if curve.policy == policy
        for severity, estimate in known_rates(curve.curve)
        if severity
    ]
    if len(found) < 2:
        return None
    _, severity, curve = min(found, key=lambda item: item[:2])
    return curve, int(-severity)
