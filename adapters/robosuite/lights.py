"""Dims, colours and turns the light of robosuite's models.

The gain is not put into the lamps. MuJoCo limits the light that falls on a surface to 1 before the surface's texture
comes in, and robosuite's lamps add up to 1.2 on what is level: at half the light, which is 0.73 of the lamps, floors
and tables would be half a stop darker and walls a whole one. What is drawn is lamp times surface, so the image is
scaled instead: to the number what dimmed lamps give wherever that limit is not met.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from adapters.adjusting import Light, unit
from adapters.contract import FloatArray, Image
from adapters.robosuite.frame import BaseFrame
from suites.photometry import encoded, linear

KEY = 0
"""The one lamp of robosuite's tables. The headlight, which follows the camera, has no direction of its own."""


class RobosuiteLights:
    """See `adapters.adjusting.Lights`. What is drawn passes through `develop`; directions follow when it is drawn."""

    def __init__(self, model: Any, frame: BaseFrame) -> None:
        """Args: model: MuJoCo's; frame: the robot's base."""
        self._model, self._frame = model, frame
        self._own_direction = model.light_dir[KEY].copy()
        self._gain = np.ones(3)
        self._developed: Image | None = None
        """What becomes of each value in each channel, (256, 3); None while nothing changes."""

    def undo(self) -> None:
        """Give the scene its own light back."""
        self._model.light_dir[KEY] = self._own_direction
        self._gain, self._developed = np.ones(3), None

    def light(self) -> Light:
        """The gain that images are developed with, and the key light's direction as MuJoCo has it."""
        return Light(self._gain.copy(), unit(-self._frame.rotation.inv().apply(self._model.light_dir[KEY])))

    def set_light(self, light: Light) -> None:
        """Give the scene another light, until the next reset."""
        self._model.light_dir[KEY] = -self._frame.rotation.apply(light.direction)
        self._gain = np.array(light.gain, dtype=np.float64)
        self._developed = None if (self._gain == 1.0).all() else development(self._gain)

    def develop(self, image: Image) -> Image:
        """What was drawn under the own lamps, (height, width, 3), as it is under the light that was set."""
        return image if self._developed is None else self._developed[image, np.arange(3)]


def development(gain: FloatArray) -> Image:
    """What becomes of each sRGB value in each channel, (256, 3), when its linear light is scaled by `gain`, (3,)."""
    scaled = encoded(linear(np.arange(256)[:, None]) * gain)
    return np.clip(np.round(scaled), 0, 255).astype(np.uint8)
