"""Scripted oracles for Meta-World: its own policies, which were written for its observation vector.

`metaworld.policies` is imported when an episode begins, in the process that has Meta-World open. The version that
`constraints.txt` pins is part of what these oracles are; the digest covers this module only.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from robogauntlet.adapters.catalog import simulators
from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import Script, State

ACTION_SCALE = 0.01
"""What Meta-World makes of a full command (m)."""
SHUT = 0.03
"""Distance between the fingers' bodies when they are shut (m); 0.1 is 1 to Meta-World."""


class Scripted:
    """Meta-World's policy for a task."""

    def __init__(self, task: str) -> None:
        self._policy = importlib.import_module("metaworld.policies").ENV_POLICY_MAP[task]()

    def __call__(self, state: State) -> FloatArray:
        """The next action (7,)."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # It says at every step that far goals are clipped.
            command = self._policy.get_action(observation(state)).astype(np.float64)
        action = np.zeros(7)
        action[:3] = np.clip(in_base(command[:3]), -1.0, 1.0) * ACTION_SCALE
        action[6] = np.clip(command[3], -1.0, 1.0)
        return action


def observation(state: State) -> FloatArray:
    """Meta-World's observation vector (39,) from a privileged state, with what its policies read.

    Hand and how far the fingers are open, then position and orientation of two things (orientations are 0: nobody reads
    them), the same once more for the step before (0 likewise), and the goal.
    """
    seen = np.zeros(39)
    seen[0:3] = in_world(state["hand_position"])
    seen[3] = np.clip((SHUT + state["finger_positions"].sum()) / 0.1, 0.0, 1.0)
    seen[4:7] = in_world(state["object_position"])
    if "other_position" in state:
        seen[11:14] = in_world(state["other_position"])
    seen[36:39] = in_world(state["goal_position"])
    return seen


def in_world(vector: FloatArray) -> FloatArray:
    """A vector (3,) of the base frame in Meta-World's, whose y is forward and whose x is to the right."""
    return np.array([-vector[1], vector[0], vector[2]])


def in_base(vector: FloatArray) -> FloatArray:
    """The way back."""
    return np.array([vector[1], -vector[0], vector[2]])


def scripts_of(tasks: Iterable[str]) -> dict[str, Callable[[], Script]]:
    """Full name of each task, by its name in Meta-World, to its script."""
    return {f"metaworld/{task}": partial(Scripted, task) for task in tasks}


SCRIPTS = scripts_of(found.tasks if (found := simulators().get("metaworld")) else ())
