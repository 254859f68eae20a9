"""Whether the shipped experts are worse with the simplified meshes of `fast-2` than with `fast`, on the same seeds."""

import json
from collections.abc import Mapping

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.results.statistics.pairs import Pairs, is_no_worse, paired_difference, pooled
from robogauntlet_mergevla.options import expert_folders
from robogauntlet_mergevla.zoo import shipped
from studies.percent import few
from studies.shared import EXPERTS, POLICY_OPTIONS, play_suite, table_of

PROFILES = ("fast-2", "fast")
SIMULATORS = ("maniskill", "pybullet", "robosuite")
SEEDS = 300
"""Seeds of each of three tasks."""
MARGIN = 0.03
SUITE = """
name: simplified-meshes
policies: [{{kind: {policy}, options: {options}}}]
tasks: {tasks}
seeds: {{start: 3000100, count: {seeds}}}
render_profile: {profile}
"""


def measure() -> list[dict[str, object]]:
    """Successes with both profiles, their paired difference, and the test of non-inferiority."""
    rows: list[dict[str, object]] = []
    all_tasks = expert_folders(shipped("zoo:experts"))
    for simulator in SIMULATORS[: few(len(SIMULATORS), 1)]:
        tasks = json.dumps([task for task in all_tasks if task.startswith(f"{simulator}/")])
        outcomes: list[dict[tuple[str, int], bool]] = []
        for profile in PROFILES:
            options = json.dumps(POLICY_OPTIONS[EXPERTS])
            text = SUITE.format(policy=EXPERTS, options=options, tasks=tasks, seeds=SEEDS, profile=profile)
            outcomes.append({(row.task, row.seed): row.status == "success" for row in play_suite(text)})
        by_task = {
            task: Pairs.from_outcomes(*(_of(task, played) for played in outcomes))
            for task in sorted({task for task, _ in outcomes[0]})
        }
        rows += [_row(task, pairs) for task, pairs in by_task.items()]
        rows.append(_row(f"{simulator}/*", pooled(by_task.values())))
    columns = {"tasks": "{task}", "pairs": "{pairs}", "fast-2": "{simplified}", "fast": "{whole}"}
    columns |= {"difference, points": "{difference:+.1f} [{low:+.1f}, {high:+.1f}]"}
    table_of(rows, columns | {"not worse by 3 points": "{no_worse}"})
    return rows


def _of(task: str, played: Mapping[tuple[str, int], bool]) -> FloatArray:
    """Outcomes of a task in the order of their seeds, (seeds,)."""
    return np.array([played[key] for key in sorted(played) if key[0] == task], dtype=np.float64)


def _row(task: str, pairs: Pairs) -> dict[str, object]:
    found = paired_difference(pairs)
    assert found is not None
    assert found.interval is not None
    difference, low, high = (100 * value for value in (found.value, found.interval.low, found.interval.high))
    row = {"task": task, "pairs": pairs.trials, "simplified": pairs.first, "whole": pairs.second}
    return row | {"difference": difference, "low": low, "high": high, "no_worse": is_no_worse(pairs, margin=MARGIN)}
