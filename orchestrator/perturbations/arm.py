"""An arm that starts elsewhere."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import Delivered, NotDelivered
from robogauntlet.adapters.scene_control import Arm, Unreachable, unit
from robogauntlet.orchestrator.perturbations.base import Perturbed

LOWEST = 0.03
"""Least height of the tool above the table (m)."""
DRAWS = 200


class RobotStart(Perturbed):
    """The tool at another place, turned where the arm can turn it."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then move the arm to the first of many drawn poses that it can reach.

        Raises:
            UnsupportedCondition: This simulation's arm cannot be moved.
            NotDelivered: It can reach none of them.
        """
        super().reset(seed)
        arm: Arm = self.offered(self.scene_controls.arm, "the arm start elsewhere")
        before = self.simulation.privileged_state()
        floor = self.scene_controls.stage.table_height + LOWEST if self.scene_controls.stage else -math.inf
        own = Rotation.from_quat(before["tcp_quaternion"])
        for _ in range(DRAWS):
            position = before["tcp_position"] + self.level / 100 * unit(self.generator.standard_normal(3))
            turn = Rotation.from_rotvec(
                math.radians(self.secondary_level) * arm.turns * unit(self.generator.standard_normal(3))
            )
            if position[2] < floor:
                continue
            try:
                arm.place_tool(position, (turn * own).as_quat())
            except Unreachable:
                continue
            after = self.simulation.privileged_state()
            self._way = float(100 * np.linalg.norm(after["tcp_position"] - before["tcp_position"]))
            self._turned = math.degrees((Rotation.from_quat(after["tcp_quaternion"]) * own.inv()).magnitude())
            return
        raise NotDelivered(
            f"{self.episode.condition}: expected a start that the arm can reach, {DRAWS} were out of reach"
        )

    def delivered(self) -> Delivered | None:
        """How far the tool is from its own start (cm), and by how much it is turned (deg)."""
        return Delivered(self.checked(self._way), {"turned": self._turned})
