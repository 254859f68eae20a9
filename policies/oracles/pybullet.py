"""Scripted oracles for panda-gym. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, distance, limit, move

FAST, GENTLE = 0.024, 0.012
"""Longest translation in one step (m): in free space, and close to or with the cube."""
CLOSE_GAIN, GAIN = 0.6, 0.42
"""Share of the remaining distance in one step: close to or with the cube, and in free space."""
HOVER = 0.06
"""Height of the tool above the cube's centre at which it may move across (m)."""
XY = slice(0, 2)
UP = np.array([0.0, 0.0, 1.0])


class Reach:
    """Moves the closed gripper straight to the goal."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        return move(state, state["goal_position"], gripper=CLOSED, max_step=FAST, gain=GAIN)


class Push:
    """Moves behind the cube as seen from the goal, down, and pushes along the line to the goal."""

    BEHIND = 0.055
    """Distance from the cube's centre at which the fingers move down (m)."""
    TOUCH = 0.03
    """Distance from the cube's centre at which the fingers touch it (m)."""
    CENTRED = 0.01
    """Lateral distance from the line to the goal beyond which the fingers retreat instead of pushing (m)."""
    REACH = 0.79
    """Horizontal distance from the base that the arm reaches at the height of the cube (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tool, cube = state["tcp_position"], state["cube_position"]
        to_goal = (state["goal_position"] - cube) * (1.0, 1.0, 0.0)
        remaining = float(np.linalg.norm(to_goal))
        forward = to_goal / max(remaining, 1e-6)
        sideways = np.array([-forward[1], forward[0], 0.0])
        ahead, lateral = float((tool - cube) @ forward), float((tool - cube) @ sideways)

        low = tool[2] < cube[2] + HOVER / 3
        if low and ahead < -self.TOUCH / 2 and abs(lateral) < max(self.TOUCH, -ahead):
            push = CLOSE_GAIN * (remaining + max(-ahead - self.TOUCH, 0.0))
            alignment = np.clip(2.0 - 2.0 * abs(lateral) / self.CENTRED, -1.0, 1.0)
            target = tool + forward * min(push, GENTLE * alignment) - sideways * 1.5 * CLOSE_GAIN * lateral
            target[2] += CLOSE_GAIN * (cube[2] - tool[2])
            return move(state, target, gripper=CLOSED, max_step=FAST)

        behind = cube - forward * self.BEHIND
        behind[XY] = limit(behind[XY], self.REACH)
        if distance(state, behind, axes=XY) < self.CENTRED:
            return move(state, behind, gripper=CLOSED, max_step=GENTLE, gain=CLOSE_GAIN)
        return travel(state, behind + UP * HOVER, gripper=CLOSED)


class PickAndPlace:
    """Grasps the cube from above and carries it to the goal in a low arc."""

    ALIGNED = 0.012
    """Distance from the cube's vertical axis at which the open fingers may move down (m)."""
    HELD_WIDTH = 0.044
    """Distance between the fingers below which they hold a cube, 0.04 wide, that is between them (m)."""
    WITHIN = 0.012
    """Distance between tool and cube at which the fingers begin to close (m)."""
    SLIPPED = 0.03
    """Distance between tool and cube at which closing fingers have lost the cube (m)."""
    ARC = 0.05
    """Height of the arc above the goal (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tool, cube, goal = state["tcp_position"], state["cube_position"], state["goal_position"]
        width = float(state["finger_positions"].sum())
        closing = width < 0.07
        if distance(state, cube) < (self.SLIPPED if closing and width > 0.03 else self.WITHIN):
            if width > self.HELD_WIDTH:
                return move(state, cube, gripper=CLOSED, max_step=GENTLE, gain=CLOSE_GAIN)
            rise = np.clip(np.linalg.norm((goal - cube)[XY]) - self.ARC / 2, 0.0, self.ARC)
            return move(state, goal + UP * rise + tool - cube, gripper=CLOSED, max_step=FAST, gain=GAIN)
        if distance(state, cube, axes=XY) < self.ALIGNED:
            return move(state, cube, gripper=OPEN, max_step=GENTLE, gain=CLOSE_GAIN)
        return travel(state, cube + UP * HOVER, gripper=OPEN)


def travel(state: State, target: FloatArray, *, gripper: float) -> FloatArray:
    """Return one action (7,) towards a point above the table, upwards first if the tool is too low to pass the cube."""
    too_low = target[2] - state["tcp_position"][2]
    if too_low > HOVER / 4:
        target = np.append(state["tcp_position"][XY], target[2])
    return move(state, target, gripper=gripper, max_step=FAST, gain=GAIN)


SCRIPTS: dict[str, Callable[[], Script]] = {
    "pybullet/PandaReach-v3": Reach,
    "pybullet/PandaPush-v3": Push,
    "pybullet/PandaPickAndPlace-v3": PickAndPlace,
}
