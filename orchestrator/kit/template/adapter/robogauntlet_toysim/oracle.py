"""Scripted oracles of toysim: they read the true state, and show that each task can be solved."""

from __future__ import annotations

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import OPEN, State, move


class Reach:
    """Goes straight to the ball and stays there. Each episode has a new object, so it may keep state."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,) for this privileged state."""
        above = state["ball_position"] + np.array([0.0, 0.0, 0.02])
        return move(state, above, gripper=OPEN, max_step=0.03)


SCRIPTS = {"toysim/Reach": Reach}
