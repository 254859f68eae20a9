"""What a report says besides its tables: the verdict, the provenance, and one sentence per term."""

from __future__ import annotations

from datetime import UTC, datetime

from results.judging import LEAST_SOLVED
from results.report import text
from results.run import RunDocument, RunStatus
from results.tables import NotRun, Tables
from suites.vocabulary import SUCCESS_HOLD

SENTENCES = {
    "success": f"The task's own predicate held for {SUCCESS_HOLD} control steps in a row within the horizon; if not, "
    "the episode is a failure. Success once asks for a single step only.",
    "rate": "Successes / (successes + failures).",
    "interval": "Wilson's, 95 %, in brackets behind the rate: 19 of 20 such intervals contain the true rate.",
    "pooled": "Over several tasks, every episode weighs the same; in the mean of tasks, every task weighs the same.",
    "condition": "Clean, or a perturbation axis at a severity from 1 (mild) to 5 (extreme).",
    "error": "An episode that could not be played. It is never counted as a failure and is in no rate.",
    "bounds": "What the rate would be if all errors and missing episodes had failed, or all had succeeded.",
    "done": "The episode has a row, whether success, failure or error; missing means that it has none.",
    "build": "Importing the simulator and opening the task.",
    "load": "Loading the policy.",
    "reset": "Putting the scene into the episode's first state.",
    "physics": "Control steps.",
    "render": "Observing: drawing the camera images.",
    "inference": "Asking the policy.",
    "rest": "Time of an episode that is in no other phase.",
    "wait": "A worker with nothing to do.",
    "busy": "Worker time after start-up spent in simulator or policy: "
    "(reset + physics + render + inference) / (wall + wait).",
    "expert": "Each task's own policy, before merging.",
    "told": "The merged policy, told the true task (oracle-routed).",
    "routed": "The merged policy, inferring its task from the first observation.",
    "loss": "Difference of success rates in percentage points, with Newcombe's paired interval (95 %). By merging: "
    "expert minus told. By routing: told minus routed. Both: their sum.",
    "pairs": "Episodes of the same task and seed on which all three sides have a verdict; pairs with an error or "
    "a missing row are left out of the losses and counted.",
    "retention": "Successes of the routed policy per success of the expert; the interval is a bootstrap over pairs "
    "within tasks, and absent where all pairs agree.",
    "accuracy": "Episodes whose task was inferred rightly, of those in which one was inferred.",
    "calibration": "Calibration error: mean distance of accuracy and the probability that the router gave its choice. "
    "Brier score: mean squared distance of all its probabilities from the truth, 0 to 2. Both where its scores are "
    "logarithms of probabilities.",
    "regret": "Success lost on the misrouted pairs: told minus routed, in percentage points.",
    "latency": "Time to infer the task, once per episode.",
    "severity curve": "Success at each severity with Wilson's interval; over several tasks, all tasks weigh the same. "
    "Drop: clean rate minus rate on the same seeds, with Newcombe's paired interval (95 %).",
    "area kept": "Area under the success kept of the clean rate, divided by the range of severities: 1 if nothing is "
    "lost. Only where the clean rate is shown to exceed 20 %. This interval and the next are a bootstrap of whole "
    "seeds within tasks, and absent where it shows no spread.",
    "half lost at": "Severity at which a falling fit loses half of the clean rate; > is beyond the last one played.",
    "falls": "One-sided p-value against success not falling with severity, given each seed's own successes; not "
    "adjusted for the number of axes.",
    "findings": "Made from the tests below: falls by the trend test, adjusted over the axes of a policy (Holm, 5 %); "
    "differences of policies where the interval for all axes together leaves out 0.",
    "all axes": "Over all levels of all axes, tasks weighing alike: mean success; mean of the middle half of the "
    "levels (IQM); mean of the worst fifth (CVaR); and the axis with the lowest mean, with the share of the "
    "bootstrap's data sets in which it is the lowest too. Intervals by a bootstrap of seeds within tasks, none where "
    "it shows no spread; that of the worst axis does not know that it was chosen for being the worst.",
    "agreement": "Axes in the order of what is lost along them in two simulators. Kendall's tau-b: 1 for the same "
    "order, -1 for the opposite; its interval is that of other seeds for the same axes (a bootstrap; chance pulls it "
    "towards 0), p is one-sided against unrelated orders. MMRV: success (percentage points of the first simulator) by "
    "which an axis is misplaced at worst, on average. Tasks differ between simulators too.",
    "heat map": "Success with Wilson's interval, and the number of episodes that count; over several tasks and "
    "simulators, all tasks weigh the same.",
    "lost against": "Baseline minus policy on the same seeds, with Newcombe's paired interval; p by the exact McNemar "
    "test, adjusted over all levels of the policy (Benjamini-Hochberg): exploratory.",
    "lost beyond clean": "Mean loss over the severities of an axis minus the loss in the clean world: whether the "
    "policy loses more when the world changes. Intervals by a bootstrap of seeds within tasks, each alone (95 %) and "
    "for all axes together (Bonferroni).",
    "gave way first": "At the first level at which success is below the clean rate beyond chance (intervals apart): "
    "the router, if more than half of what was lost there was lost on misrouted episodes, else the policy.",
    "control": "A condition in which a policy that sees and listens should fail: what it still does there needs no "
    "eyes, no instruction, or not this one. Lost: clean rate minus rate, on the same seeds.",
    "gate": "An oracle must solve a seed under the clean condition and at every level of an axis for it to count "
    f"there; a level at which it solves less than {100 * LEAST_SOLVED:.0f} % of a task's seeds says nothing about that "
    "task and is left out.",
    "delivered": "Mean over the episodes in which it was measured, with the least and the greatest of an episode; "
    "apart: distance of the simulators' means as a share of what was asked for.",
    "skipped": "The simulator could not run on this machine; its episodes count as missing.",
}
"""One explanation per term, shown where it first appears."""
MERGING_TERMS = ("expert", "told", "routed", "loss", "pairs", "retention")
ROBUSTNESS_TERMS = ("severity curve", "area kept", "half lost at", "falls")
SHIFT_TERMS = ("lost against", "lost beyond clean")
ROUTER_TERMS = ("accuracy", "calibration", "regret", "latency")

_STATUS = {
    RunStatus.COMPLETE: "Complete",
    RunStatus.RUNNING: "Still running",
    RunStatus.INTERRUPTED: "Interrupted",
    RunStatus.STOPPED: "Stopped early",
}


def status_word(document: RunDocument) -> str:
    """How far the run came, in a word or two."""
    return _STATUS[document.status]


def verdict(document: RunDocument, tables: Tables) -> str:
    """The run in one sentence: episodes done of planned, errors, time, and why it ended early, if it did."""
    total = tables.total
    parts = [f"{total.done:,} of {text.counted(total.planned, 'episode')} done"]
    parts.append(text.counted(total.errors, "error") if total.errors else "no errors")
    parts.append(text.counted(len(tables.skipped), "simulator") + " skipped" if tables.skipped else "")
    parts.append(f"in {text.seconds(document.elapsed_s)}" if document.elapsed_s else "")
    return ", ".join(filter(None, parts)) + (f"; {document.reason}" if document.reason else "")


def provenance(document: RunDocument, tables: Tables) -> list[tuple[str, str]]:
    """With what, where and when the run was made, as (name, value)."""
    made = document.provenance
    dirty = {None: "", True: " with uncommitted changes", False: " (clean)"}[made.git_dirty]
    facts = [
        ("run", document.run_id),
        ("suite", f"{document.suite_name} ({document.suite_path})"),
        ("suite hash", document.suite_hash),
        ("rows hash", document.rows_hash or "not computed"),
        *((f"policy {name}", digest) for name, digest in {c.policy: c.policy_digest for c in tables.cells}.items()),
        ("git commit", f"{made.git_commit}{dirty}" if made.git_commit else "unknown"),
        ("started", _moment(document.started_at)),
        ("ended", _moment(document.finished_at)),
        ("time running", text.seconds(document.elapsed_s)),
        ("store", document.store_url or "file in the run folder"),
        *((f"{name} drawn by", device) for name, device in document.render_devices.items()),
        *((f"{name} workers", str(count)) for name, count in document.workers.items()),
        *([("policies", "computed in processes of their own, in batches")] if document.inference == "served" else []),
        (
            "machine",
            ", ".join(filter(None, (made.processor, f"{made.cores} cores" if made.cores else "", made.platform))),
        ),
        ("Python", made.python),
    ]
    return [(name, value or "unknown") for name, value in facts]


def gaps(tables: Tables) -> tuple[NotRun, ...]:
    """Cells with missing episodes, those of skipped simulators aside."""
    skipped = {simulator for simulator, _ in tables.skipped}
    return tuple(gap for gap in tables.not_run if gap.simulator not in skipped)


def skipped_episodes(tables: Tables) -> dict[str, int]:
    """Skipped simulator to its missing episodes."""
    return {
        simulator: sum(gap.missing for gap in tables.not_run if gap.simulator == simulator)
        for simulator, _ in tables.skipped
    }


def _moment(seconds: float | None) -> str:
    return "not yet" if seconds is None else datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
