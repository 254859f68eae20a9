"""`report.md`: the numbers of the report as GitHub Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from robogauntlet.results.analysis.behaviour import BehaviourRow
from robogauntlet.results.analysis.combinations import Combinations
from robogauntlet.results.analysis.condition_comparison import ConditionComparison
from robogauntlet.results.analysis.failures import Failures
from robogauntlet.results.analysis.merging_cost import Merging
from robogauntlet.results.analysis.pairwise import PairwiseComparisons
from robogauntlet.results.analysis.robustness import Robustness
from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.analysis.timing import PHASES
from robogauntlet.results.report import behaviour as behaviour_text
from robogauntlet.results.report import combinations as combinations_text
from robogauntlet.results.report import condition_comparison as condition_texts
from robogauntlet.results.report import facts, formatting, robots
from robogauntlet.results.report import failures as failures_text
from robogauntlet.results.report import merging_cost as merging_text
from robogauntlet.results.report import pairwise as pairwise_text
from robogauntlet.results.report import robustness as robustness_text
from robogauntlet.results.report.facts import DEFINITIONS
from robogauntlet.results.report.formatting import TextTable, escape, markdown
from robogauntlet.results.report.summary import ERROR_GROUPS, Report


def render_markdown(report: Report) -> str:
    """Return the report as GitHub Markdown."""
    document, tables = report.document, report.tables
    parts = [
        f"# {escape(document.suite.name)}",
        f"**{facts.status_word(document)}**: {escape(facts.verdict(document, tables))}",
    ]
    parts += [f"**Warning**: {escape(warning)}." for warning in document.warnings]
    if document.suite.description:
        parts.append(escape(document.suite.description))
    if not tables.total.done:
        parts.append("**This run has no results yet.**")
    parts += _combinations(report.combinations) if report.combinations else []
    parts += ["## Success rates", _define("success", "rate", "interval", "pooled")]
    parts.append(markdown(formatting.summary_table(tables)))
    for simulator in tables.simulators:
        parts += [f"### {escape(simulator)}", markdown(formatting.task_table(tables, simulator))]
    parts.append(_define("done", "error", "bounds"))
    if report.robots:
        parts += ["## By robot", robots.EXPLANATION, markdown(robots.robot_table(report.robots))]
    parts += _failures(report.failures) if report.failures else []
    parts += _behaviour(report.behaviour) if report.behaviour else []
    parts += _pairwise(report.pairwise) if report.pairwise else []
    parts += _robustness(report.robustness, report.findings) if report.robustness else []
    parts += _merging(report.merging) if report.merging else []
    parts += _not_run(tables) + _errors(tables) + _timing(tables)
    rows = tuple(facts.provenance(document))
    parts += ["## Provenance", markdown(TextTable(("what", "value"), rows, 2))]
    packages = tuple(sorted(document.provenance.versions.items()))
    if packages:
        parts.append(markdown(TextTable(("package", "version"), packages, 2)))
    return "\n\n".join(parts) + "\n"


def _define(*terms: str) -> str:
    return "\n".join(f"- {term}: {escape(DEFINITIONS[term])}" for term in terms)


def _failures(found: Failures) -> list[str]:
    sentences = "\n".join(f"- {escape(sentence)}" for sentence in failures_text.sentences(found))
    parts = ["## How it fails", sentences, _define(*found.kinds)]
    parts.append("Numbers of failures, and shares of all failures of the row with 95 % intervals:")
    for one in found.policies:
        if one.total.failures:
            table = markdown(failures_text.failure_table(found, one))
            parts += [f"### {escape(one.policy)}, {escape(one.simulator)}: kinds of failures", table]
    return parts


def _behaviour(rows: Sequence[BehaviourRow]) -> list[str]:
    parts = ["## How it moves", "Clean episodes: medians, with quartiles in parentheses."]
    tables = [markdown(behaviour_text.success_table(rows)), markdown(behaviour_text.episode_table(rows))]
    return [
        *parts,
        _define(*facts.BEHAVIOUR_TERMS),
        "### Successes",
        tables[0],
        "### Successes and failures",
        tables[1],
    ]


def _pairwise(found: PairwiseComparisons) -> list[str]:
    notes = "\n".join(f"- {term}: {escape(definition)}" for term, definition in pairwise_text.terms(found))
    return ["## A against B", notes, pairwise_text.markdown_section(found)]


def _merging(merging: Merging) -> list[str]:
    parts = ["## Merging and routing", _define(*facts.MERGING_TERMS), markdown(merging_text.comparison_table(merging))]
    if any(comparison.router for comparison in merging.routed):
        parts += ["### Routers", _define(*facts.ROUTER_TERMS), markdown(merging_text.router_table(merging))]
    for comparison in merging.routed:
        parts += [f"### Losses of {escape(comparison.policy)}", markdown(merging_text.losses_table(comparison))]
        if comparison.router:
            confusion = merging_text.confusion_table(comparison.router.confusion)
            parts += ["True task and inferred task:", markdown(confusion)]
        bins = merging_text.calibration_table(comparison)
        parts += ["Accuracy by confidence:", markdown(bins)] if bins else []
    return parts


def _combinations(found: Combinations) -> list[str]:
    if not found.policies:
        return []
    parts = ["## Why it fails", _define(*facts.COMBINATION_TERMS)]
    for one in found.policies:
        sentences = "\n".join(f"- {escape(sentence)}" for sentence in combinations_text.sentences(one, found.axes))
        parts += [f"### {escape(one.policy)}, {escape(one.simulator)}", sentences]
        if combinations_text.by_total(one):
            parts.append(markdown(combinations_text.index_table(one)))
        if one.clusters:
            parts.append(markdown(combinations_text.cluster_table(one)))
        parts += ["Success by severity of each axis, whatever the others are:"]
        parts.append(markdown(combinations_text.effect_table(one)))
    if found.agreement:
        agreement = markdown(combinations_text.agreement_table(found))
        parts += ["### Agreement of simulators on axes", _define("agreement on axes"), agreement]
    return parts


def _robustness(robustness: Robustness, findings: Sequence[str]) -> list[str]:
    parts = ["## Robustness"]
    if robustness.axes or robustness.controls or robustness.condition_comparison is not None:
        parts += _curves(robustness, findings)
    parts += ["### Repeated episodes", escape(condition_texts.repeats_sentence(robustness))]
    parts += ["### Oracle gate", escape(robustness_text.oracle_gate_sentence(robustness))]
    if robustness.gate_rows:
        parts += [_define("oracle gate"), markdown(robustness_text.gate_table(robustness))]
    if robustness.axes:
        parts += ["### Delivered perturbations", escape(robustness_text.start_states_sentence(robustness))]
        parts += [_define("delivered"), markdown(robustness_text.delivered_table(robustness))]
    if robustness.unsupported:
        parts += ["### Unsupported", markdown(robustness_text.unsupported_table(robustness))]
    return parts


def _curves(robustness: Robustness, findings: Sequence[str]) -> list[str]:
    parts = [_define("findings"), "\n".join(f"- {escape(sentence)}" for sentence in findings)]
    parts.append(_define("heat map"))
    for found in condition_texts.heat_maps(robustness):
        parts += [
            f"### {escape(found.policy)}: success under all conditions",
            markdown(condition_texts.heat_table(found)),
        ]
    if summary := robustness.summary:
        parts += ["### All axes together", _define("all axes"), markdown(robustness_text.summary_table(summary))]
        if summary.agreement:
            agreement = markdown(robustness_text.agreement_table(summary))
            parts += ["### Agreement of simulators", _define("agreement"), agreement]
    if robustness.condition_comparison is not None:
        parts += _condition_comparison(robustness.condition_comparison)
    parts.append(_define(*facts.ROBUSTNESS_TERMS))
    parts += [escape(subtracted)] if (subtracted := condition_texts.no_skill_sentence(robustness)) else []
    for axis in robustness.axes:
        parts.append(f"### {escape(robustness_text.axis_heading(axis))}")
        if robustness_text.axis_curves(robustness, axis):
            parts.append(markdown(robustness_text.curves_table(robustness, axis)))
        else:
            parts.append("No results with a clean condition to compare.")
    if robustness.controls:
        parts += ["### Controls", _define("control"), markdown(robustness_text.controls_table(robustness))]
    return parts


def _condition_comparison(found: ConditionComparison) -> list[str]:
    parts = [f"### Comparison with {escape(found.baseline)}", _define(*facts.SHIFT_TERMS)]
    parts += [escape(rule)] if (rule := condition_texts.stopping_rule(found)) else []
    parts += [markdown(condition_texts.interaction_table(found)), markdown(condition_texts.loss_table(found))]
    if found.routers:
        parts += [
            "### Routers under perturbation",
            _define("failed first"),
            markdown(condition_texts.router_table(found)),
        ]
    return parts


def _not_run(tables: Tables) -> list[str]:
    if not tables.not_run and not tables.skipped:
        return ["## Missing episodes", "All planned episodes have a result."]
    parts = ["## Missing episodes"]
    episodes = facts.skipped_episodes(tables)
    for simulator, reason in tables.skipped:
        number = formatting.counted(episodes[simulator], "episode")
        parts.append(f"- {escape(simulator)} was skipped ({number}): {escape(reason)}")
    gaps = facts.gaps(tables)
    rows = tuple((g.task, g.policy, str(g.condition), g.reason, formatting.count(g.missing)) for g in gaps)
    if rows:
        parts.append(markdown(TextTable(("task", "policy", "condition", "reason", "missing"), rows, 4)))
    return parts


def _errors(tables: Tables) -> list[str]:
    if not tables.errors:
        return []
    rows = tuple(
        (group.message, ", ".join(group.tasks), ", ".join(group.examples), formatting.count(group.count))
        for group in tables.errors[:ERROR_GROUPS]
    )
    more = len(tables.errors) - len(rows)
    parts = ["## Errors", _define("error"), markdown(TextTable(("message", "tasks", "episodes", "count"), rows, 3))]
    return [*parts, f"{more:,} more messages are in `episodes.parquet`."] if more else parts


def _timing(tables: Tables) -> list[str]:
    if not tables.timing:
        return []
    return ["## Worker time", _define(*PHASES, "busy"), markdown(formatting.timing_table(tables.timing))]
