"""PushT of gym-pusht: a disc pushes a T-shaped block onto its outline, seen from above."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, FloatArray, Image, Joint
from robogauntlet.adapters.gymnasium.mapping import EnvironmentMapping, Moment

METRES = 0.001
"""Of a pixel of the board, which has no size of its own: 512 pixels are 0.512 m."""
SLIDES = tuple(Joint(name, 0.0, 512 * METRES, 512 * METRES) for name in ("slide_x", "slide_y"))


class PushT(EnvironmentMapping):
    """The disc slides along two axes, from the board's upper left corner to the right and down.

    An action has their targets. In the base frame, at that corner, x is to the right and y up in the image. Success is
    95 % of the outline covered, and the reward the share of that.
    """

    name = "PushT-v0"
    env = "gym_pusht:gym_pusht/PushT-v0"
    make: ClassVar = {"obs_type": "state"}  # of its own it would draw in each step
    instruction = "push the grey T onto the green outline"
    horizon = 300
    action_spec = ActionSpec(0.0, 0.0, 10.0, ("gripper",), joints=SLIDES)

    def observe(self, moment: Moment) -> dict[str, FloatArray]:
        """Return disc, slides, block and goal."""
        slides = METRES * np.array(moment.world.agent.position)
        return {
            "tcp_position": _point(slides),
            "tcp_quaternion": np.array([1.0, 0.0, 0.0, 0.0]),
            "finger_positions": np.zeros(2),
            "joint_angles": slides,
            "joint_targets": slides if moment.action is None else METRES * moment.action,
            "gripper": np.array([-1.0]),
            "tcp_jacobian": np.array([[1.0, 0.0], [0.0, -1.0], *4 * [[0.0, 0.0]]]),
            **_pose("block", moment.info["block_pose"]),
            **_pose("goal", moment.info["goal_pose"]),
        }

    def action(self, action: FloatArray) -> FloatArray:
        """Return the targets in pixels."""
        return action[:2] / METRES

    def success(self, moment: Moment) -> bool:
        """Return what the environment says."""
        return bool(moment.info["is_success"])

    def image(self, moment: Moment, size: int) -> Image:
        """Return the board as the environment's own observations have it, without the target that `render` marks."""
        world = moment.world
        kept = world.obs_type, world.observation_width, world.observation_height
        try:
            world.obs_type, world.observation_width, world.observation_height = "pixels", size, size
            pixels: Image = world.get_obs()
        finally:
            world.obs_type, world.observation_width, world.observation_height = kept
        return pixels


def _point(slides: FloatArray) -> FloatArray:
    return np.array([slides[0], -slides[1], 0.0])


def _pose(name: str, pose: Any) -> dict[str, FloatArray]:
    """Position and orientation of a body on the board; the image's y is down, so that it turns the other way round."""
    x, y, angle = pose
    turned = np.array([0.0, 0.0, np.sin(-angle / 2), np.cos(angle / 2)])
    return {f"{name}_position": _point(METRES * np.array([x, y])), f"{name}_quaternion": turned}
