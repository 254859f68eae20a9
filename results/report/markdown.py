"""`report.md`: the numbers of the report as text, for a terminal, a pull request or a diff."""

from __future__ import annotations

from results.merging import Merging
from results.report import facts, overall, text
from results.report import merging as words
from results.report import robustness as stress
from results.report import shift as against
from results.report.facts import SENTENCES
from results.report.findings import findings
from results.report.summary import ERROR_GROUPS
from results.report.text import TextTable, escape, markdown
from results.robustness import Robustness
from results.run import RunDocument
from results.shift import Shift
from results.tables import Tables
from results.timing import PHASES


def render_markdown(
    document: RunDocument, tables: Tables, merging: Merging | None = None, robustness: Robustness | None = None
) -> str:
    """The whole report as GitHub Markdown."""
    parts = [
        f"# {escape(document.suite_name)}",
        f"**{facts.status_word(document)}**: {escape(facts.verdict(document, tables))}",
    ]
    if document.suite_description:
        parts.append(escape(document.suite_description))
    if not tables.total.done:
        parts.append("**This run has no rows yet**, so there is no rate to show.")
    parts += ["## Success rates", _says("success", "rate", "interval", "pooled"), markdown(text.summary_table(tables))]
    for simulator in tables.simulators:
        parts += [f"### {escape(simulator)}", markdown(text.task_table(tables, simulator))]
    parts.append(_says("done", "error", "bounds"))
    parts += _robustness(robustness) if robustness else []
    parts += _merging(merging) if merging else []
    parts += _not_run(tables) + _errors(tables) + _timing(tables)
    rows = tuple(facts.provenance(document, tables))
    parts += ["## Provenance", markdown(TextTable(("what", "value"), rows, 2))]
    packages = tuple(sorted(document.provenance.versions.items()))
    if packages:
        parts.append(markdown(TextTable(("package", "version"), packages, 2)))
    return "\n\n".join(parts) + "\n"


def _says(*terms: str) -> str:
    return "\n".join(f"- {term}: {escape(SENTENCES[term])}" for term in terms)


def _merging(merging: Merging) -> list[str]:
    parts = ["## Merging and routing", _says(*facts.MERGING_TERMS), markdown(words.comparison_table(merging))]
    if any(comparison.router for comparison in merging.routed):
        parts += ["### Routers", _says(*facts.ROUTER_TERMS), markdown(words.router_table(merging))]
    for comparison in merging.routed:
        parts += [f"### Losses of {escape(comparison.policy)}", markdown(words.losses_table(comparison))]
        if comparison.router:
            parts += ["True task and inferred task:", markdown(words.confusion_table(comparison.router.confusion))]
        bins = words.calibration_table(comparison)
        parts += ["Accuracy by confidence:", markdown(bins)] if bins else []
    return parts


def _robustness(robustness: Robustness) -> list[str]:
    parts = ["## Robustness", _says("findings"), "\n".join(f"- {escape(said)}" for said in findings(robustness))]
    parts.append(_says("heat map"))
    for found in against.heat_maps(robustness):
        parts += [f"### {escape(found.policy)} under all axes", markdown(against.heat_table(found))]
    if robustness.overall is not None:
        parts += ["### All axes together", _says("all axes"), markdown(overall.overall_table(robustness.overall))]
    if robustness.overall is not None and robustness.overall.agreement:
        parts += ["### Do simulators agree?", _says("agreement")]
        parts.append(markdown(overall.agreement_table(robustness.overall)))
    if robustness.shift is not None:
        parts += _shift(robustness.shift)
    parts.append(_says(*facts.ROBUSTNESS_TERMS))
    parts += [escape(taken_off)] if (taken_off := against.floors(robustness)) else []
    for axis in robustness.axes:
        parts.append(f"### {escape(stress.title(axis))}")
        curves = stress.of_axis(robustness, axis)
        parts.append(markdown(stress.curves_table(robustness, axis)) if curves else "No result beside a clean one.")
    if robustness.controls:
        parts += ["### Controls", _says("control"), markdown(stress.controls_table(robustness))]
    parts += ["### Played twice", escape(against.repeats(robustness))]
    parts += ["### Gate", escape(stress.gate(robustness))]
    if robustness.gated:
        parts += [_says("gate"), markdown(stress.gate_table(robustness))]
    parts += ["### Delivered", escape(stress.worlds(robustness)), _says("delivered")]
    parts.append(markdown(stress.delivered_table(robustness)))
    if robustness.unsupported:
        parts += ["### Unsupported", markdown(stress.unsupported_table(robustness))]
    return parts


def _shift(found: Shift) -> list[str]:
    parts = [f"### Against {escape(found.baseline)}", _says(*facts.SHIFT_TERMS)]
    parts += [escape(rule)] if (rule := against.stopping(found)) else []
    parts += [markdown(against.interaction_table(found)), markdown(against.tax_table(found))]
    if found.routers:
        parts += ["### Routers under perturbation", _says("gave way first"), markdown(against.router_table(found))]
    return parts


def _not_run(tables: Tables) -> list[str]:
    if not tables.not_run and not tables.skipped:
        return ["## What was not run", "Nothing: every planned episode has a row."]
    parts = ["## What was not run"]
    episodes = facts.skipped_episodes(tables)
    for simulator, reason in tables.skipped:
        number = text.counted(episodes[simulator], "episode")
        parts.append(f"- {escape(simulator)} was skipped ({number}): {escape(reason)}")
    rows = tuple((g.task, g.policy, str(g.condition), g.reason, text.count(g.missing)) for g in facts.gaps(tables))
    return (
        [*parts, markdown(TextTable(("task", "policy", "condition", "reason", "missing"), rows, 4))] if rows else parts
    )


def _errors(tables: Tables) -> list[str]:
    if not tables.errors:
        return []
    rows = tuple(
        (group.message, ", ".join(group.tasks), ", ".join(group.examples), text.count(group.count))
        for group in tables.errors[:ERROR_GROUPS]
    )
    more = len(tables.errors) - len(rows)
    parts = ["## Errors", _says("error"), markdown(TextTable(("message", "tasks", "episodes", "count"), rows, 3))]
    return [*parts, f"{more:,} more messages are in `episodes.parquet`."] if more else parts


def _timing(tables: Tables) -> list[str]:
    if not tables.timing:
        return []
    return ["## Where the time went", _says(*PHASES, "busy"), markdown(text.timing_table(tables.timing))]
