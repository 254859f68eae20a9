"""Definitions of terms, the status sentence and the provenance of a report."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from robogauntlet.results.analysis.eligible_episodes import LEAST_SOLVED
from robogauntlet.results.analysis.failures import OTHER
from robogauntlet.results.analysis.tables import NotRun, Tables
from robogauntlet.results.record import FailureKind, is_left_out
from robogauntlet.results.report import formatting
from robogauntlet.results.run_document import RunDocument, RunStatus
from robogauntlet.suites.episode import SUCCESS_HOLD, ProtocolName, SuccessRule
from robogauntlet.support.text import counted, first_of

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
SUCCESS_OF_OTHERS = "A trial that the file of others calls one; the others with a verdict are failures."
"""Definition of success in a run of which only outcomes are known."""
DEFINITIONS = {
    "success": f"The task's success predicate held for {SUCCESS_HOLD} consecutive control steps (or for a "
    "single one, where the first lines say so) within the horizon; otherwise the episode is a failure. Success once "
    "requires a single step in any run.",
    "rate": "The share of successes among the episodes that were played, successes / (successes + failures); errors "
    "do not count.",
    "interval": "95 % Wilson interval, in brackets after the rate: 19 of 20 such intervals contain the true rate.",
    "pooled": "Rates over several tasks weigh every episode equally; the mean of tasks weighs every task equally.",
    "error": "An episode that could not be played. It is neither a success nor a failure and is excluded from rates.",
    "bounds": "The rate if all errors and missing episodes had failed, and if all had succeeded.",
    "done": "Episodes with a result: success, failure or error. The others are missing.",
    "build": "Importing the simulator and opening the task.",
    "load": "Loading the policy.",
    "reset": "Setting the start state of the episode.",
    "physics": "Control steps.",
    "render": "Observing, including rendering of the camera images.",
    "inference": "Querying the policy.",
    "rest": "Time of an episode outside the other phases.",
    "wait": "Idle time of a worker.",
    "busy": "Share of worker time after start-up in simulator or policy: "
    "(reset + physics + render + inference) / (wall + wait).",
    "severity curve": "Success at each severity with Wilson interval; tasks have equal weight. "
    "Drop: clean rate minus rate on the same seeds, with Newcombe's paired interval (95 %).",
    "area kept": "Area under success relative to the clean rate, divided by the range of severities: 1 if nothing is "
    "lost. Only if the clean rate significantly exceeds 20 %. Student's interval (95 %) for the spread of seeds within "
    "tasks, absent where they do not differ.",
    "half lost at": "Severity at which a monotone fit has lost half of the clean rate; > means beyond the last one.",
    "trend p": "One-sided p-value of the hypothesis that success does not fall with severity, conditional on the "
    "successes of each seed; not adjusted for the number of axes. An axis whose severities are kinds has no trend, "
    "area or half.",
    "findings": "From the tests below: drops by the trend test, adjusted over the axes of a policy (Holm, 5 %), "
    "and differences of policies if the simultaneous interval for all axes excludes 0. Equivalence over all levels, "
    "levels and tasks having equal weight: Student's 90 % interval lies within the margin (two one-sided tests).",
    "all axes": "Over all levels of all axes, with equal weight of tasks: the mean, and the axis with the lowest mean. "
    "Without intervals: the lowest of many rates is too low by chance, and near 100 % a few seeds decide the mean.",
    "agreement": "Whether two simulators order the axes alike by success lost. Kendall's tau-b: 1 for the same order, "
    "-1 for the opposite; p is one-sided, for independent orders. MMRV: mean over axes of the largest rank violation, "
    "in percentage points of the first simulator. No intervals: chance pulls tau towards 0 and raises MMRV. Tasks "
    "differ between simulators, too.",
    "heat map": "Success with Wilson interval, and the number of episodes that count; tasks have equal weight.",
    "lost against": "Baseline minus policy on the same seeds, with Newcombe's paired interval; p of the exact McNemar "
    "test, adjusted over all levels of the policy (Benjamini-Hochberg): exploratory.",
    "lost beyond clean": "Mean loss over the severities of an axis minus the loss under the clean condition. "
    "Student's intervals for the spread of seeds within tasks, for each axis (95 %) and simultaneous for all axes "
    "(Bonferroni).",
    "difference": "Success rate of the first policy minus that of the second on the same clean episodes (task, seed "
    "and protocol), in percentage points, with Newcombe's paired interval (95 %, not adjusted). Episodes without a "
    "verdict of both are left out.",
    "only": "Pairs in which only the first, or only the second, policy succeeded. The others do not tell them apart.",
    "p": "McNemar's exact test, two-sided: the probability of so one-sided a count of these pairs for equal rates. "
    "Adjusted by Holm's method: over all comparisons, and over the simulators and tasks in which enough pairs disagree "
    "for the test to reach 0.05; the others have 1.",
    "detectable": "The smallest difference, in percentage points, that as many pairs show with a probability of 80 % "
    "(p at most 0.05, not adjusted), if as large a share of them disagrees.",
    "perturbed pairs": "Episodes under a perturbation, paired by task, axis, severity, seed and protocol. Tasks are "
    "added up, severities are not, since they share their seeds. Adjusted by Holm's method over the severities of an "
    "axis in all comparisons: of many axes without a difference, one in twenty shows one. Controls and combinations "
    "are not compared, and no oracle gate applies: every pair counts.",
    "median difference": "The median over the start states (task and seed) at which both succeeded, first minus "
    "second; 95 % bootstrap interval of start states within tasks. p: Wilcoxon's signed-rank test, two-sided, adjusted "
    "by Holm's method over all measures of all comparisons in which enough pairs differ for the test to reach 0.05. "
    "Where only one succeeded, nothing is compared.",
    "letters": "Policies that share a letter do not differ significantly (McNemar's exact test on the episodes of "
    "both, or Fisher's on separate trials if start states are not known; adjusted by Holm's method).",
    "control": "A condition in which a policy that uses images and instruction should fail: remaining success does not "
    "depend on them. Lost: clean rate minus rate, on the same seeds.",
    "oracle gate": "A seed counts along an axis only if the oracle solves it under the clean condition and at every "
    f"level. A level at which the oracle solves less than {100 * LEAST_SOLVED:.0f} % of a task's seeds is left out for "
    "this task.",
    "delivered": "Mean measured strength of the perturbation, with minimum and maximum over episodes. Spread: range of "
    "the simulators' means relative to the requested value. Episodes in which an axis delivered nothing count in no "
    "rate.",
    "sensitivity index": "Share of the variance of the success rate in which an axis takes part, by itself or together "
    "with others (total Sobol' index); the shares of axes that act together overlap. Noise of single episodes is not "
    "counted. 95 % intervals over points and seeds.",
    "failure cluster": "Severities of one or two axes from which on a policy fails more often than elsewhere, and for "
    "two axes also more often than with one of them alone. Found on one half of the seeds and confirmed on the other, "
    "from which the rates are; p adjusted by Holm's method over all candidates. Lift: failure there divided by failure "
    "elsewhere.",
    "agreement on axes": "Kendall's tau-b of the total indices in two simulators, with a one-sided p-value.",
    **{str(kind): f"The robot {did}." for kind, did in PHRASES.items()},
    OTHER: "A failure of a task that declares no goal, or of a kind that this version does not know.",
    "skipped": "The simulator cannot run on this machine; its episodes count as missing.",
}
"""Definition per term; the end of a report lists those that it uses."""
PAIRWISE_TERMS = ("difference", "only", "p", "detectable", "perturbed pairs", "median difference", "letters")
PROTOCOLS = {
    ProtocolName.ROBOGAUNTLET: "robogauntlet: images are upright",
    ProtocolName.OPENVLA: "openvla: images are upright and mirrored",
}
RULES = {
    SuccessRule.HELD: f"held: the predicate holds for {SUCCESS_HOLD} control steps in a row",
    SuccessRule.ONCE: "once: the predicate holds after a single control step, at which the episode ends",
}

_STATUS = {
    RunStatus.COMPLETE: "Complete",
    RunStatus.RUNNING: "Still running",
    RunStatus.INTERRUPTED: "Interrupted",
    RunStatus.STOPPED: "Stopped early",
}


def status_word(document: RunDocument) -> str:
    """Return the status of the run in a few words, `Complete` or `Complete, imported`."""
    return _STATUS[document.status] + (", imported" if document.origin == "imported" else "")


def verdict(document: RunDocument, tables: Tables) -> str:
    """Return the run in one sentence: episodes, errors, time, and the reason for an early end."""
    total = tables.total
    parts = [f"{total.done:,} of {formatting.counted(total.planned, 'episode')} done"]
    left_out = sum(group.count for group in tables.errors if is_left_out(group.message))
    parts.append(formatting.counted(total.errors, "error") if total.errors else "no errors")
    parts.append(f"of which {left_out:,} left out for missing files" if left_out else "")
    parts.append(left_out_tasks(document.tasks_left_out) if document.tasks_left_out else "")
    parts.append(formatting.counted(len(tables.skipped), "simulator") + " skipped" if tables.skipped else "")
    parts.append(f"in {formatting.seconds(document.elapsed_s)}" if document.elapsed_s else "")
    if document.suite.protocol is not ProtocolName.ROBOGAUNTLET:
        parts.append(f"under the protocol {document.suite.protocol}")
    if document.suite.success_rule is SuccessRule.ONCE:
        parts.append("success at a single step")
    return ", ".join(filter(None, parts)) + (f"; {document.reason}" if document.reason else "")


def left_out_tasks(tasks: Sequence[str]) -> str:
    """Return in words that the run does not play these tasks of its suite."""
    return f"{formatting.counted(len(tasks), 'task')} of the suite left out, in which a policy cannot act"


def left_out(tables: Tables) -> tuple[str, ...]:
    """Return a sentence for each reason for which episodes were left out."""
    groups = (group for group in tables.errors if is_left_out(group.message))
    return tuple(f"{formatting.counted(group.count, 'episode')} {group.message}" for group in groups)


def provenance(document: RunDocument) -> list[tuple[str, str]]:
    """Return suite, policies, software and hardware of the run as (name, value)."""
    software = document.provenance
    machine = (software.processor, counted(software.cores, "core") if software.cores else "", software.platform)
    dirty = {None: "", True: " with uncommitted changes", False: " (clean)"}[software.git_dirty]
    facts = [
        ("run", document.run_id),
        ("suite", f"{document.suite.name} ({document.suite_path})"),
        *([] if document.is_outcomes_only else _rules(document)),
        *([("tasks left out", first_of(document.tasks_left_out))] if document.tasks_left_out else []),
        ("suite hash", document.suite_hash),
        ("rows hash", document.rows_hash or "not computed"),
        *((f"policy {name}", digest) for name, digest in {c.policy: c.policy_digest for c in document.plan}.items()),
        ("git commit", f"{software.git_commit}{dirty}" if software.git_commit else "unknown"),
        ("started", _moment(document.started_at)),
        ("ended", _moment(document.finished_at)),
        ("time running", formatting.seconds(document.elapsed_s)),
        ("store", document.store_url or "file in the run folder"),
        *((f"{name} render device", device) for name, device in document.render_devices.items()),
        *((f"{name} workers", str(count)) for name, count in document.workers.items()),
        *([("workers for all simulators", str(document.shared_workers))] if document.shared_workers else []),
        *([("policies", "in separate inference processes, batched")] if document.inference == "served" else []),
        ("machine", ", ".join(filter(None, machine))),
        ("Python", software.python),
    ]
    return [(name, value or "unknown") for name, value in facts]


def _rules(document: RunDocument) -> list[tuple[str, str]]:
    suite = document.suite
    return [
        ("protocol", PROTOCOLS[suite.protocol]),
        ("success", RULES[suite.success_rule]),
        ("images", f"{suite.image_size} px, {suite.render_profile}"),
    ]


def gaps(tables: Tables) -> tuple[NotRun, ...]:
    """Return cells with missing episodes, without those of skipped simulators."""
    skipped = {simulator for simulator, _ in tables.skipped}
    return tuple(gap for gap in tables.not_run if gap.simulator not in skipped)


def skipped_episodes(tables: Tables) -> dict[str, int]:
    """Return the number of missing episodes by skipped simulator."""
    names = (simulator for simulator, _ in tables.skipped)
    return {name: sum(gap.missing for gap in tables.not_run if gap.simulator == name) for name in names}


def _moment(seconds: float | None) -> str:
    if seconds is None:
        return "not yet"
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (OverflowError, OSError, ValueError):
        return formatting.NOTHING
