"""Dims, colours and turns the light of models based on robosuite.

The gain is not applied to the lamps. MuJoCo limits the light on a surface to 1 before it applies the texture, and
robosuite's lamps add up to 1.2 on level surfaces: at half the light, which is 0.73 of the lamps, floors and tables
would be half a stop darker and walls a whole one. Pixels are lamp times surface, so the image is scaled instead, which
equals dimmed lamps wherever the limit is not reached.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray, Image
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.photometry import encoded, linear
from robogauntlet.adapters.scene_control import Light, unit


class MujocoLights:
    """`Lights` of `scene_control`. Images pass through `develop`; directions follow at the next rendering."""

    def __init__(self, physics: MujocoPhysics, key: int = 0, *, lit: FloatArray | None = None) -> None:
        """Take the number of the key light; the headlight, which follows the camera, has no direction.

        A key light with a position is rotated about `lit`, a point (3,) of the world (m).
        """
        self._physics, self._model, self._key, self._lit = physics, physics.model, key, lit
        model = physics.model
        self._own_direction, self._own_position = model.light_dir[key].copy(), model.light_pos[key].copy()
        self._gain = np.ones(3)
        self._developed: Image | None = None
        """Each pixel value in each channel to its new value, (256, 3); None for a gain of 1."""

    def undo(self) -> None:
        """Restore the light."""
        self._model.light_dir[self._key] = self._own_direction
        self._model.light_pos[self._key] = self._own_position
        self._gain, self._developed = np.ones(3), None

    def light(self) -> Light:
        """Return the gain of images, and the key light's present direction."""
        model = self._model
        away = -model.light_dir[self._key] if self._lit is None else model.light_pos[self._key] - self._lit
        return Light(self._gain.copy(), unit(self._physics.rotation.inv().apply(away)))

    def set_light(self, light: Light) -> None:
        """Set the light, until the next reset."""
        away = self._physics.rotation.apply(light.direction)
        if self._lit is None:
            self._model.light_dir[self._key] = -away
        else:  # Moved on a sphere; its aim relative to the point stays.
            lever = self._own_position - self._lit
            turn, _ = Rotation.align_vectors(away[None], unit(lever)[None])
            self._model.light_pos[self._key] = self._lit + turn.apply(lever)
            self._model.light_dir[self._key] = turn.apply(self._own_direction)
        self._gain = np.array(light.gain, dtype=np.float64)
        self._developed = None if (self._gain == 1.0).all() else development(self._gain)

    def develop(self, image: Image) -> Image:
        """Convert an image under the own lamps, (height, width, 3), to the light that was set."""
        return image if self._developed is None else self._developed[image, np.arange(3)]


def development(gain: FloatArray) -> Image:
    """Return the new sRGB value of each value in each channel, (256, 3), for a gain (3,) of linear light."""
    scaled = encoded(linear(np.arange(256)[:, None]) * gain)
    return np.clip(np.round(scaled), 0, 255).astype(np.uint8)
