"""A toy in place of your simulator: a gripper floats above a table with a ball. Nothing has mass.

Base frame, metres, radians. The tool's z axis points out of the gripper, its fingers open along its y axis.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

OPEN = 0.04
"""Largest distance of each finger from the middle (m)."""
FINGER_SPEED = 0.01
"""Distance that each finger moves in one control step (m)."""
LOWEST = 0.02
"""Smallest height of the tool above the table (m)."""
TO_THE_LAMP = np.array([0.36, 0.48, 0.8])
TABLE = np.array([[150, 140, 125], [105, 95, 85]])
BLUE, GREY, RED = (60, 90, 200), (70, 70, 75), (220, 60, 50)


class World:
    """A simulator with the usual Python interface: reset, step, draw."""

    def reset(self, seed: int) -> None:
        """Put the gripper above the table and the ball on it."""
        generator = np.random.default_rng(seed)
        self.tool = np.array([0.45, 0.0, 0.2]) + generator.uniform(-0.02, 0.02, 3)
        self.turn = Rotation.from_rotvec([np.pi, 0.0, 0.0])
        self.fingers = np.full(2, OPEN)
        self.ball = np.array([*generator.uniform([0.4, -0.12], [0.6, 0.12]), 0.025])

    def step(self, translation: Array, rotation: Array, closing: bool) -> None:
        """Move the tool by a translation (3,), m, and a rotation vector (3,), rad, and the fingers a little."""
        self.tool = self.tool + translation
        self.tool[2] = max(self.tool[2], LOWEST)
        self.turn = Rotation.from_rotvec(rotation) * self.turn
        self.fingers = np.clip(self.fingers + (-FINGER_SPEED if closing else FINGER_SPEED), 0.0, OPEN)

    def draw(self, eye: Array, axes: Array, fovy: float, size: int) -> NDArray[np.uint8]:
        """Render an image (size, size, 3) by ray casting.

        Args:
            eye: Position of the pinhole (3,), m.
            axes: The image's right, down and forward as columns, (3, 3).
            fovy: Vertical field of view (rad).
            size: Height and width (px).
        """
        along = (np.arange(size) + 0.5) / size * 2.0 - 1.0
        right, down = np.meshgrid(along, along)
        rays = np.stack([right, down, np.full_like(right, 1.0 / np.tan(fovy / 2.0))], axis=-1) @ axes.T
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        image = np.full((size, size, 3), 225.0)
        nearest = np.full((size, size), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -eye[2] / rays[..., 2]
        hit = (distance > 0.0) & (distance < 5.0)
        chequer = np.floor((eye + rays * np.where(hit, distance, 0.0)[..., None])[..., :2] / 0.1).sum(axis=-1)
        image[hit] = TABLE[chequer[hit].astype(int) % 2]
        nearest[hit] = distance[hit]
        for centre, radius, colour in self._balls():
            to_centre = eye - centre
            half = rays @ to_centre
            inside = half**2 - to_centre @ to_centre + radius**2
            distance = -half - np.sqrt(np.maximum(inside, 0.0))
            hit = (inside > 0.0) & (distance > 0.0) & (distance < nearest)
            normals = (to_centre + rays[hit] * distance[hit][:, None]) / radius
            image[hit] = np.array(colour) * (0.5 + 0.5 * np.clip(normals @ TO_THE_LAMP, 0.0, 1.0))[:, None]
            nearest[hit] = distance[hit]
        return image.astype(np.uint8)

    def _balls(self) -> list[tuple[Array, float, Any]]:
        """List the balls that are drawn: centre, radius, colour."""
        sideways = self.turn.apply([0.0, 1.0, 0.0])
        tips = [
            self.tool + side * (finger + 0.01) * sideways for side, finger in zip((-1, 1), self.fingers, strict=True)
        ]
        palm = self.tool - self.turn.apply([0.0, 0.0, 0.09])
        return [(self.ball, 0.025, RED), (palm, 0.05, GREY), *((tip, 0.015, BLUE) for tip in tips)]
