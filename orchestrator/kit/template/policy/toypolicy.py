"""A policy for RoboGauntlet. Replace what is in `__call__` by your own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

STEPS = 4
"""Actions of a chunk; the policy is queried again when they are executed."""


class Toypolicy:
    """Moves sideways to what is red in the image of the wrist camera, and down to it."""

    def __init__(self, speed: float = 0.01) -> None:
        """Load what the policy needs; `speed` is in metres per control step."""
        self.speed = speed
        self.offset = np.zeros(2)

    def reset(self) -> None:
        """Forget the last episode. RoboGauntlet calls this at the start of each."""
        self.offset = np.zeros(2)

    def __call__(self, images: Mapping[str, np.ndarray], proprioception: np.ndarray, instruction: str) -> np.ndarray:
        """Return the next actions.

        Args:
            images: Camera (`third_person`, `wrist`) to an upright RGB image, shape (size, size, 3), uint8.
            proprioception: Position of the tool (m), its axis-angle (rad), positions of the two fingers (m): (8,).
            instruction: The goal in words.

        Returns:
            Shape (n, 7): translation (m) and rotation (axis-angle, rad) of the tool in the robot's base frame (x
            forward, y left, z up), gripper from -1 (open) to +1 (closed).
        """
        red, green, blue = np.moveaxis(images["wrist"].astype(np.float64), -1, 0)
        rows, columns = np.nonzero(red > 60 + np.maximum(green, blue))
        if len(rows):  # else it stays where it was last seen
            self.offset = np.array([rows.mean(), columns.mean()]) / len(red) - 0.5
        actions = np.zeros((STEPS, 7))
        actions[:, :2] = 2 * self.speed * self.offset  # lower rows are further forward, later columns further left
        actions[:, 2] = -0.5 * self.speed if proprioception[2] > 0.08 else 0.0
        actions[:, 6] = -1.0
        return actions
