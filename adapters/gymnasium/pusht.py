"""PushT of gym-pusht: a disc pushes a T-shaped block onto its outline, seen from above."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, FloatArray, Image, Number
from robogauntlet.adapters.gymnasium.mapping import EnvironmentMapping, Moment

BOARD = tuple(Number(name, 0.0, 512.0) for name in ("x", "y"))
"""Places on the board (px), from its upper left corner to the right and down."""


class PushT(EnvironmentMapping):
    """An action is the disc's target, and proprioception its place.

    Success is 95 % of the outline covered, and the reward the share of that.
    """

    name = "PushT-v0"
    env = "gym_pusht:gym_pusht/PushT-v0"
    make: ClassVar = {"obs_type": "state"}  # of its own it would draw in each step
    instruction = "push the grey T onto the green outline"
    horizon = 300
    action_spec = ActionSpec(0.0, 0.0, 10.0, numbers=BOARD, state=("x", "y"))

    def observe(self, moment: Moment) -> dict[str, FloatArray]:
        """Return the disc's place, the target that holds it, and places and angles of block and outline (px, rad)."""
        place = np.array(moment.world.agent.position)
        poses = {name: np.array(moment.info[name], np.float64) for name in ("block_pose", "goal_pose")}
        return {"state": place, "still": place if moment.action is None else moment.action, **poses}

    def action(self, action: FloatArray) -> FloatArray:
        """Return it as it is."""
        return action

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
