"""The tasks of Meta-World, as `tasks.yaml` declares them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from robogauntlet.adapters.contract import Goal, TaskDescription

_DECLARED = yaml.safe_load(Path(__file__).with_name("tasks.yaml").read_text(encoding="utf-8"))
HANDLES = {name: np.array(task["handle"]) for name, task in _DECLARED.items() if "handle" in task}
"""Where the tool is when the hand touches the object, relative to `object_position`, in tasks where it is beside it."""


def declared_goal(task: str, values: Mapping[str, Any]) -> Goal:
    """Return a task's goal: that the object reaches `goal_position`, with the changes of `tasks.yaml`."""
    handle = {"handle": "handle_position"} if task in HANDLES else {}
    goal = {"entry": "object_position", "to": "goal_position", **handle, **values}
    return Goal(**goal | {"offset": tuple(goal.get("offset", Goal.offset))})


TASKS = {
    name: TaskDescription(task["instruction"], task["horizon"], goal=declared_goal(name, task["goal"]))
    for name, task in _DECLARED.items()
}
