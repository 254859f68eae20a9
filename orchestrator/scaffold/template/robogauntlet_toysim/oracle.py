"""Scripted oracles of toysim: they read the true state, and prove that each task can be solved."""

from __future__ import annotations

import numpy as np

from adapters.contract import FloatArray
from policies.oracles.motion import OPEN, State, move


class Reach:
    """Goes straight to the ball and stays there. Made anew for each episode, so it may remember things."""

    def __call__(self, state: State) -> FloatArray:
        """The next action (7,) for this privileged state."""
        above = state["ball_position"] + np.array([0.0, 0.0, 0.02])
        return move(state, above, gripper=OPEN, max_step=0.03)


SCRIPTS = {"toysim/Reach": Reach}
