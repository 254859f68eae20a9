"""Dims, colours and turns the light of robosuite's models, and of those that are built on it.

The gain is not put into the lamps. MuJoCo limits the light that falls on a surface to 1 before the surface's texture
comes in, and robosuite's lamps add up to 1.2 on what is level: at half the light, which is 0.73 of the lamps, floors
and tables would be half a stop darker and walls a whole one. What is drawn is lamp times surface, so the image is
scaled instead: to the number what dimmed lamps give wherever that limit is not met.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Light, unit
from adapters.contract import FloatArray, Image
from adapters.mujoco_parts.frame import BaseFrame
from suites.photometry import encoded, linear


class MujocoLights:
    """See `adapters.adjusting.Lights`. What is drawn passes through `develop`; directions follow when it is drawn."""

    def __init__(self, model: Any, frame: BaseFrame, key: int = 0, *, lit: FloatArray | None = None) -> None:
        """Take the lamps.

        Args:
            model: MuJoCo's.
            frame: The robot's base.
            key: Number of the key light. The headlight, which follows the camera, has no direction of its own.
            lit: If the key light stands somewhere instead of shining alike on everything: the point (3,) of the
                world, m, that it is turned about.
        """
        self._model, self._frame, self._key, self._lit = model, frame, key, lit
        self._own_direction, self._own_position = model.light_dir[key].copy(), model.light_pos[key].copy()
        self._gain = np.ones(3)
        self._developed: Image | None = None
        """What becomes of each value in each channel, (256, 3); None while nothing changes."""

    def undo(self) -> None:
        """Give the scene its own light back."""
        self._model.light_dir[self._key] = self._own_direction
        self._model.light_pos[self._key] = self._own_position
        self._gain, self._developed = np.ones(3), None

    def light(self) -> Light:
        """The gain that images are developed with, and the key light's direction as MuJoCo has it."""
        model = self._model
        away = -model.light_dir[self._key] if self._lit is None else model.light_pos[self._key] - self._lit
        return Light(self._gain.copy(), unit(self._frame.rotation.inv().apply(away)))

    def set_light(self, light: Light) -> None:
        """Give the scene another light, until the next reset."""
        away = self._frame.rotation.apply(light.direction)
        if self._lit is None:
            self._model.light_dir[self._key] = -away
        else:  # Carried round: it shines as far off its mark as before.
            lever = self._own_position - self._lit
            turn, _ = Rotation.align_vectors(away[None], unit(lever)[None])
            self._model.light_pos[self._key] = self._lit + turn.apply(lever)
            self._model.light_dir[self._key] = turn.apply(self._own_direction)
        self._gain = np.array(light.gain, dtype=np.float64)
        self._developed = None if (self._gain == 1.0).all() else development(self._gain)

    def develop(self, image: Image) -> Image:
        """What was drawn under the own lamps, (height, width, 3), as it is under the light that was set."""
        return image if self._developed is None else self._developed[image, np.arange(3)]


def development(gain: FloatArray) -> Image:
    """What becomes of each sRGB value in each channel, (256, 3), when its linear light is scaled by `gain`, (3,)."""
    scaled = encoded(linear(np.arange(256)[:, None]) * gain)
    return np.clip(np.round(scaled), 0, 255).astype(np.uint8)
