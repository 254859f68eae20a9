"""Findings of a run as sentences, derived from its statistical tests."""

from __future__ import annotations

from collections.abc import Sequence

from robogauntlet.results.analysis.condition_comparison import ConditionComparison
from robogauntlet.results.analysis.robustness import PolicyCurve, Robustness
from robogauntlet.results.report import formatting
from robogauntlet.results.report.condition_comparison import condition_text, equivalence_sentence, worst_level
from robogauntlet.results.report.formatting import points, rate
from robogauntlet.results.report.robustness import agreement_findings, known_rates, overall_curves
from robogauntlet.results.statistics.multiplicity import ALPHA, holm
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import Condition

MAX_NAMED = 3
"""Axes that are named with their rates in one sentence."""


def findings(robustness: Robustness) -> tuple[str, ...]:
    """Return sentences, the most important first. Absence of evidence is stated as such."""
    policies = dict.fromkeys(
        curve.policy for curve in robustness.curves if curve.policy not in robustness.no_skill_baselines
    )
    sentences = [sentence for policy in policies for sentence in _drops(robustness, policy)]
    if robustness.condition_comparison is not None:
        sentences += _merging(robustness.condition_comparison)
    if robustness.summary is not None:
        sentences += agreement_findings(robustness.summary)
    left_out = [row for row in robustness.gate_rows if row.capped]
    if left_out:
        conditions = dict.fromkeys(Condition(row.axis, row.severity) for row in left_out)
        names = [str(condition) for condition in conditions if not condition.is_combination]
        combined = len(conditions) - len(names)
        levels = ", ".join([*names, *([formatting.counted(combined, "combination")] if combined else [])])
        sentences.append(
            f"{formatting.counted(len(left_out), 'level')} of a task left out because the oracle gate "
            f"{robustness.oracle_gate} solved less than 95 % of the seeds ({levels})."
        )
    return tuple(sentences)


def _drops(robustness: Robustness, policy: str) -> list[str]:
    """Axes along which success drops, adjusted over all axes of the policy (Holm); those without a scale have none."""
    scales = [axis for axis in robustness.axes if axis not in AXES or AXES[axis].ordered]
    curves = [c for axis in scales for c in overall_curves(robustness, axis) if c.policy == policy]
    if curves and not any(clean.value for curve in curves for _, clean in known_rates(curve.curve)[:1]):
        return [f"{policy}: clean success is 0 %, so that no axis can lower it."]
    tested = [(curve, curve.curve.trend) for curve in curves if curve.curve.trend is not None]
    adjusted = holm([p for _, p in tested if p is not None]) if tested else ()
    dropped = [curve for (curve, _), p in zip(tested, adjusted, strict=True) if p <= ALPHA]
    sentences = []
    if dropped:
        worst = sorted(dropped, key=lambda curve: known_rates(curve.curve)[-1][1].value)
        where = _listed([_drop(curve) for curve in worst[:MAX_NAMED]])
        if len(worst) > MAX_NAMED:
            where = f"{len(worst)} of {len(curves)} axes, to the lowest rates along {where}"
        sentences.append(f"{policy}: success drops with severity along {where}.")
    rest = [curve for curve in curves if curve not in dropped]
    if rest:
        names = _listed([curve.axis for curve in rest])
        sentences.append(f"{policy}: no significant drop along {names} (not evidence of no drop).")
    lowest = worst_level(robustness, policy)
    if lowest is not None:
        curve, severity = lowest
        found = curve.curve.rates[curve.curve.levels.index(severity)]
        if found.value < curve.curve.rates[0].value:
            sentences.append(f"{policy}: lowest at {condition_text(curve.axis, severity)}, {rate(found)}.")
    return sentences


def _drop(found: PolicyCurve) -> str:
    shown = known_rates(found.curve)
    (_, clean), (severity, last) = shown[0], shown[-1]
    level = AXES[found.axis].describe(int(severity))
    return f"{found.axis} ({formatting.percent(clean.value)} to {formatting.percent(last.value)} at {level})"


def _merging(comparison: ConditionComparison) -> list[str]:
    sentences = []
    for policy in comparison.others:
        rows = [row for row in comparison.interactions if row.policy == policy]
        sentences += [
            equivalence_sentence(row, comparison.baseline) for row in comparison.equivalences if row.policy == policy
        ]
        if not rows:
            continue
        clean = next((row for row in comparison.losses if row.policy == policy and not row.severity), None)
        if clean is not None:
            sentences.append(
                f"{policy}: {points(clean.loss)} percentage points lost against {comparison.baseline}, clean."
            )
        more = [row for row in rows if row.is_shown and row.extra.value > 0]
        less = [row for row in rows if row.is_shown and row.extra.value < 0]
        for found, word in ((more, "more"), (less, "less")):
            if found:
                parts = [f"{row.axis} ({points(row.extra)})" for row in found]
                sentences.append(
                    f"{policy} loses {word} against {comparison.baseline} than clean along {_listed(parts)}."
                )
        if not more and not less:
            several = len(rows) > 1
            what = "no axis was shown" if several else f"{rows[0].axis} was not shown"
            together = f" ({len(rows)} axes tested together)" if several else ""
            sentences.append(
                f"{policy}: {what} to change its loss against {comparison.baseline} from the clean loss{together}."
            )
    return sentences


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
