"""What a run has shown, in sentences made from its tests and never stronger than they are."""

from __future__ import annotations

from collections.abc import Sequence

from results.report import text
from results.report.merging import points
from results.report.overall import agreement_findings
from results.report.robustness import judged, over_all, rate, short_title
from results.report.shift import level, worst_level
from results.robustness import PolicyCurve, Robustness
from results.shift import Shift, broke_first
from results.statistics.multiplicity import ALPHA, holm
from suites.axes import AXES

MOST_NAMED = 3
"""Axes that are named with their figures in one sentence."""
SEES_NOTHING, TOLD_OTHERWISE = "blind", "wrong-goal"


def findings(robustness: Robustness) -> tuple[str, ...]:
    """Sentences, the most important first. What was tested and not shown is said to be just that."""
    policies = dict.fromkeys(curve.policy for curve in robustness.curves if curve.policy not in robustness.floors)
    said = [sentence for policy in policies for sentence in _falls(robustness, policy)]
    if robustness.shift is not None:
        said += _merging(robustness.shift)
        said += _routers(robustness.shift)
    if robustness.overall is not None:
        said += agreement_findings(robustness.overall)
    said += _controls(robustness)
    left_out = [row for row in robustness.gated if row.capped]
    if left_out:
        levels = ", ".join(dict.fromkeys(level(row.axis, row.severity).partition(":")[0] for row in left_out))
        said.append(
            f"{text.counted(len(left_out), 'condition')} of a task left out because {robustness.gate} solved less than "
            f"95 % of the seeds there ({levels})."
        )
    return tuple(said)


def _falls(robustness: Robustness, policy: str) -> list[str]:
    """Along which axes success falls, all axes of the policy taken together (Holm)."""
    curves = [c for axis in robustness.axes for c in over_all(robustness, axis) if c.policy == policy]
    tested = [(curve, curve.curve.trend) for curve in curves if curve.curve.trend is not None]
    adjusted = holm([p for _, p in tested if p is not None]) if tested else ()
    fallen = [curve for (curve, _), p in zip(tested, adjusted, strict=True) if p <= ALPHA]
    said = []
    if fallen:
        worst = sorted(fallen, key=lambda curve: judged(curve.curve)[-1][1].value)
        along = _listed([_fall(curve) for curve in worst[:MOST_NAMED]])
        where = along if len(worst) <= MOST_NAMED else f"{len(worst)} of {len(curves)} axes, lowest along {along}"
        said.append(f"{policy}: success falls with severity along {where}.")
    rest = [curve for curve in curves if curve not in fallen]
    if rest:
        names = _listed([short_title(curve.axis) for curve in rest])
        said.append(f"{policy}: no fall was shown along {names}, which is no proof that there is none.")
    lowest = worst_level(robustness, policy)
    if lowest is not None:
        curve, severity = lowest
        found = curve.curve.rates[curve.curve.levels.index(severity)]
        said.append(f"{policy}: lowest at {level(curve.axis, severity)}, {rate(found)}.")
    return said


def _fall(found: PolicyCurve) -> str:
    shown = judged(found.curve)
    (_, clean), (severity, last) = shown[0], shown[-1]
    value = f"{AXES[found.axis].value(int(severity)):g} {AXES[found.axis].unit}"
    return f"{short_title(found.axis)} ({text.percent(clean.value)} to {text.percent(last.value)} at {value})"


def _merging(shift: Shift) -> list[str]:
    said = []
    for policy in shift.others:
        rows = [row for row in shift.interactions if row.policy == policy]
        if not rows:
            continue
        clean = next((row for row in shift.taxes if row.policy == policy and not row.severity), None)
        if clean is not None:
            said.append(f"{policy} against {shift.baseline}, clean: {points(clean.loss)} percentage points lost.")
        more = [row for row in rows if row.is_shown and row.extra.value > 0]
        less = [row for row in rows if row.is_shown and row.extra.value < 0]
        for found, word in ((more, "more"), (less, "less")):
            if found:
                parts = [f"{short_title(row.axis)} ({points(row.extra)})" for row in found]
                said.append(f"{policy} loses {word} against {shift.baseline} than clean under {_listed(parts)}.")
        if not more and not less:
            said.append(
                f"{policy}: no axis was shown to make it lose more, or less, against {shift.baseline} than clean "
                f"({text.counted(len(rows), 'axis').replace('axiss', 'axes')} tested together)."
            )
    return said


def _routers(shift: Shift) -> list[str]:
    said = []
    for policy in shift.others:
        axes = dict.fromkeys(row.axis for row in shift.routers if row.policy == policy)
        first = {axis: broke_first([r for r in shift.routers if (r.policy, r.axis) == (policy, axis)]) for axis in axes}
        for what in ("router", "policy"):
            names = [short_title(axis) for axis, gave_way in first.items() if gave_way == what]
            if names:
                under = _listed(names) if len(names) <= 2 * MOST_NAMED else f"{len(names)} of {len(first)} axes"
                said.append(f"{policy}: the {what} gave way first under {under}.")
    return said


def _controls(robustness: Robustness) -> list[str]:
    said = []
    for row in (row for row in robustness.controls if row.policy not in robustness.floors):
        whole = row.simulator is None or not any(r.simulator is None for r in robustness.controls)
        if not whole or row.control not in (SEES_NOTHING, TOLD_OTHERWISE):
            continue
        how = "with black images" if row.control == SEES_NOTHING else "told another goal"
        goal = "" if row.control == SEES_NOTHING else " still at the task's own"
        said.append(f"{row.policy} {how}: success{goal} {rate(row.rate)}, clean {rate(row.clean)}.")
    return said


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
