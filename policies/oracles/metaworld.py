"""Scripted oracles for Meta-World: its own policies, which act on its observation vector.

`metaworld.policies` is imported when an episode starts, in the process in which Meta-World is open. The digest covers
this module only, not the version of Meta-World, which `constraints.txt` pins.
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
"""Translation of a full command in Meta-World (m)."""
CLOSED_WIDTH = 0.03
"""Distance between the fingers' bodies when closed (m); Meta-World's opening of 1 is 0.1 m."""


class Scripted:
    """Meta-World's policy for a task."""

    def __init__(self, task: str) -> None:
        self._policy = importlib.import_module("metaworld.policies").ENV_POLICY_MAP[task]()

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a warning at every step that far goals are clipped
            command = self._policy.get_action(observation(state)).astype(np.float64)
        action = np.zeros(7)
        action[:3] = np.clip(in_base(command[:3]), -1.0, 1.0) * ACTION_SCALE
        action[6] = np.clip(command[3], -1.0, 1.0)
        return action


def observation(state: State) -> FloatArray:
    """Return Meta-World's observation vector (39,) for a privileged state, as far as its policies use it.

    Hand position and opening of the fingers, position and orientation of two objects (orientations are unused and 0),
    the same for the step before (also 0), and the goal.
    """
    vector = np.zeros(39)
    vector[0:3] = in_world(state["hand_position"])
    vector[3] = np.clip((CLOSED_WIDTH + state["finger_positions"].sum()) / 0.1, 0.0, 1.0)
    vector[4:7] = in_world(state["object_position"])
    if "other_position" in state:
        vector[11:14] = in_world(state["other_position"])
    vector[36:39] = in_world(state["goal_position"])
    return vector


def in_world(vector: FloatArray) -> FloatArray:
    """Transform a vector (3,) from the base frame to Meta-World's, with y forward and x to the right."""
    return np.array([-vector[1], vector[0], vector[2]])


def in_base(vector: FloatArray) -> FloatArray:
    """Transform a vector (3,) from Meta-World's frame to the base frame."""
    return np.array([vector[1], -vector[0], vector[2]])


def scripts_of(tasks: Iterable[str]) -> dict[str, Callable[[], Script]]:
    """Return the script of each task of Meta-World by its full name."""
    return {f"metaworld/{task}": partial(Scripted, task) for task in tasks}


SCRIPTS = scripts_of(simulator.tasks if (simulator := simulators().get("metaworld")) else ())
