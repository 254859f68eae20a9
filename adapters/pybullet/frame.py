"""Where PyBullet's world and the robot's base are to each other, and where the tool is."""

from __future__ import annotations

from typing import Any

import numpy as np

from adapters.contract import FloatArray

BASE_IN_WORLD = np.array([-0.6, 0.0, 0.0])
"""The robot's base stands here, not turned (m)."""


def tool_pose(env: Any) -> tuple[FloatArray, FloatArray]:
    """Position (m, base frame) and quaternion xyzw of the point between the fingertips of a panda-gym environment."""
    link = env.sim.physics_client.getLinkState(env.sim._bodies_idx["panda"], env.robot.ee_link)
    return np.array(link[0]) - BASE_IN_WORLD, np.array(link[1])
