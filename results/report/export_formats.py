"""Results of a policy in the file formats of other evaluation programs.

These are `eval_info.json` of LeRobot's `lerobot-eval` (Apache 2.0) and the result file of Allen AI's
vla-evaluation-harness (`src/vla_eval/results/collector.py`). Both programs count an episode as a success once the
task's predicate is true, and so do their files, whatever the run's own rule. Values that are not recorded are null or
left out.
"""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunDocument, RunError
from robogauntlet.suites.episode import Condition, SuccessRule

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    *("policy", "simulator", "task", "axis", "severity", "seed", "status", "error"),
    *("success_once", "reward_sum", "steps", "wall_s"),
)
"""Fields of the record that are needed."""


def of_policy(rows: pd.DataFrame, policy: str | None) -> pd.DataFrame:
    """Return the rows of one policy of a run, which has to be named if there are several. Raises RunError."""
    names = list(dict.fromkeys(rows["policy"]))
    if policy is None and len(names) > 1:
        raise RunError(f"expected one policy, the run has {', '.join(names)}; name one with --policy")
    if policy is not None and policy not in names:
        raise RunError(f"no episode of a policy '{policy}'; the run has {', '.join(names) or 'none'}")
    return rows if policy is None else rows[rows["policy"] == policy]


def lerobot(document: RunDocument, rows: pd.DataFrame) -> dict[str, Any]:
    """LeRobot's `eval_info.json`: per task, per group (simulator and condition) and overall.

    Episodes with an error are left out, since LeRobot has no word for them. Highest rewards are null: not recorded.
    `rows` are those of one policy, with the columns `COLUMNS`.
    """
    played = rows[rows["status"] != str(Status.ERROR)]
    per_task: list[dict[str, Any]] = []
    for (task, axis, severity), own in played.groupby(["task", "axis", "severity"], sort=True, observed=True):
        metrics = {
            "sum_rewards": own["reward_sum"].tolist(),
            "max_rewards": [None] * len(own),
            "successes": own["success_once"].tolist(),
            "seeds": own["seed"].tolist(),
            "video_paths": [],
        }
        group = _group(str(task).partition("/")[0], axis, severity)
        per_task.append({"task_group": group, "task_id": len(per_task), "task": task, "metrics": metrics})
    groups = played.groupby(["simulator", "axis", "severity"], sort=True, observed=True)
    seconds = float(played["wall_s"].sum())
    return {
        "per_task": per_task,
        "per_group": {_group(name, axis, severity): _means(own) for (name, axis, severity), own in groups},
        "overall": {**_means(played), "eval_s": seconds, "eval_ep_s": seconds / max(1, len(played))},
        "robogauntlet": _about(document),
    }


def vla_eval(document: RunDocument, rows: pd.DataFrame) -> dict[str, Any]:
    """The result file of vla-evaluation-harness. Errors have a `failure_reason` and are excluded from means.

    `rows` are those of one policy, with the columns `COLUMNS`.
    """
    played = rows[rows["status"] != str(Status.ERROR)]
    tasks = []
    for (task, axis, severity), own in rows.groupby(["task", "axis", "severity"], sort=True, observed=True):
        good = own[own["status"] != str(Status.ERROR)]
        found: dict[str, Any] = {
            "task": _group(str(task), axis, severity),
            "episodes": [_episode(row) for row in own.itertuples()],
            "num_episodes": len(own),
            "avg_steps": float(good["steps"].mean()) if len(good) else 0.0,
        }
        if len(own) > len(good):
            found["num_errors"] = len(own) - len(good)
        tasks.append(found | _mean_success(good))
    return {
        "benchmark": document.suite.name,
        "mode": "sync",
        "harness_version": f"robogauntlet {version('robogauntlet')}",
        "created_at": datetime.fromtimestamp(document.finished_at or document.started_at, UTC).isoformat(),
        "tasks": tasks,
        "config": _about(document),
        "metric_keys": {"success": "mean"},
        **_mean_success(played),
    }


def _episode(row: Any) -> dict[str, Any]:
    found = {"episode_id": int(row.seed), "metrics": {}, "steps": int(row.steps), "elapsed_sec": float(row.wall_s)}
    if row.status == str(Status.ERROR):
        kind, _, detail = str(row.error).partition(": ")
        return found | {"failure_reason": kind, "failure_detail": detail}
    return found | {"metrics": {"success": bool(row.success_once)}}


def _mean_success(played: pd.DataFrame) -> dict[str, float]:
    if played.empty:
        return {}
    return {"mean_success": round(float(played["success_once"].mean()), 4)}


def _means(played: pd.DataFrame) -> dict[str, Any]:
    reward = success = None
    if len(played):
        reward = float(played["reward_sum"].mean())
        success = 100 * float(played["success_once"].mean())
    counts = {"n_episodes": len(played), "video_paths": []}
    return {"avg_sum_reward": reward, "avg_max_reward": None, "pc_success": success, **counts}


def _group(name: str, axis: str, severity: int) -> str:
    condition = Condition(axis, int(severity))
    return name if condition == Condition() else f"{name} {condition}"


def _about(document: RunDocument) -> dict[str, Any]:
    software = document.provenance
    hashes = {"suite_hash": document.suite_hash, "rows_hash": document.rows_hash, "git_commit": software.git_commit}
    rules = {"success": str(SuccessRule.ONCE), "success_in_run": str(document.suite.success_rule)}
    return {"run_id": document.run_id, "suite": document.suite.name, **rules, **hashes, "packages": software.versions}
