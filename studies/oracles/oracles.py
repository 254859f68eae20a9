"""Successes of the oracles of ManiSkill, panda-gym and robosuite, the steps that they need, and the bounds of actions.

The run stays in `runs/bench/oracles`, so that a second call plays what is missing.
"""

import os
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import ActionSpec
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.results.api import open_run
from robogauntlet.suites.episode import RenderProfile, View
from studies.shared import run_suite, table_of
from studies.tables import WRITTEN, episodes_of, write_episodes

SIMULATORS = ("maniskill", "pybullet", "robosuite")
FIELDS = ("task", "seed", "status", "steps", "state_hash", "actions_hash", "policy_digest")
SUITE = """
name: oracles
policies: [oracle]
tasks: {tasks}
seeds: {{start: 0, count: 100}}
image_size: 96
render_profile: fast
"""


def measure() -> list[dict[str, object]]:
    """Play seeds 0 to 99 of every task within its own horizon; nothing is rendered, as the oracles do not look."""
    episodes = played("oracles", SUITE.format(tasks=list(tasks())), FIELDS)
    for name in SIMULATORS:  # Of all, before the first is imported.
        os.environ.update(worker_environment(catalog.find(name)))
    rows = rows_of(episodes, {task: _bounds(task) for task in tasks()})
    columns = {
        "task": "`{task}`",
        "horizon": "{horizon}",
        "oracle": "{successes} of {episodes}",
        "mean / most steps": "{mean_steps:.0f} / {most_steps}",
        "largest step, mm": "{step_mm:.1f}",
        "largest turn, rad": "{turn_rad:.3f}",
    }
    table_of(rows, columns)
    return rows


def played(name: str, suite_text: str, fields: Sequence[str]) -> pd.DataFrame:
    """Play a suite in a folder of that name, or what it lacks, and write a row per episode beside the measurements."""
    folder = WRITTEN / name
    folder.mkdir(parents=True, exist_ok=True)
    suite = folder / "suite.yaml"
    suite.write_text(suite_text, encoding="utf-8")
    run_suite(suite, folder / "run")
    episodes = open_run(folder / "run").episodes(fields)
    write_episodes(name, episodes, ("task", "seed"))
    return episodes


def tasks() -> dict[str, int]:
    """Return the tasks with an oracle that moves the tool to their horizons: none by joints, or by native numbers."""
    found = [(f"{name}/{task}", told) for name in SIMULATORS for task, told in catalog.find(name).tasks.items()]
    return {
        task: description.horizon for task, description in found if not description.joints and not description.native
    }


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, object]]:
    """The rows again, from the kept episodes; the bounds of actions are taken from the rows."""
    bounds = {row["task"]: (row["step_mm"], row["turn_rad"]) for row in rows}
    return rows_of(episodes_of("oracles", "oracles"), bounds)


def rows_of(episodes: pd.DataFrame, bounds: dict[str, tuple[float, float]]) -> list[dict[str, object]]:
    """Return a row for each task; `bounds` has the largest step (mm) and turn (rad) of an action in each."""
    rows: list[dict[str, object]] = []
    for task, horizon in tasks().items():
        played = episodes[episodes.task == task]
        steps = played.steps[played.status == "success"]
        counts = {"successes": len(steps), "episodes": len(played)}
        needed = {"mean_steps": float(steps.mean()), "most_steps": int(max(steps, default=0))}
        step_mm, turn_rad = bounds[task]
        rows.append({"task": task, "horizon": horizon, **counts, **needed, "step_mm": step_mm, "turn_rad": turn_rad})
    return rows


def _bounds(task: str) -> tuple[float, float]:
    simulation = catalog.open_simulation(task, View(image_size=32, render_profile=RenderProfile.FAST))
    spec: ActionSpec = simulation.action_spec
    simulation.close()
    return round(1000.0 * spec.max_translation, 3), round(spec.max_rotation, 4)
