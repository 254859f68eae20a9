"""Scripts of tools, played by the joints of the arms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robogauntlet.adapters.contract import ACTION_DIM, ARM_PREFIXES, FloatArray
from robogauntlet.policies.oracles.motion import Script, State


class ByJoints:
    """A script of tools, played with the targets or velocities of joints: damped least squares (Wampler 1986)."""

    damping = 1e-3
    """Added to J J'; keeps joints from racing where an arm is stretched."""

    def __init__(self, script: Callable[[], Script], velocities_hz: float | None = None) -> None:
        """Take what makes the script, and the control rate if actions have velocities."""
        self._script, self._hz = script(), velocities_hz

    def __call__(self, state: State) -> FloatArray:
        """Return the next action, for each arm its joints and the gripper."""
        motions, parts = self._script(state).reshape(-1, ACTION_DIM), []
        for arm, motion in zip(ARM_PREFIXES, motions, strict=False):
            jacobian = state[f"{arm}tcp_jacobian"]
            turns = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + self.damping * np.eye(6), motion[:6])
            parts += [turns * self._hz if self._hz else state[f"{arm}joint_targets"] + turns, motion[6:]]
        return np.concatenate(parts)
