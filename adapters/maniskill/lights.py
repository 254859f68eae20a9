"""Dims, colours and rotates the lamps of ManiSkill's scenes."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.photometry import gain_of, pixel_factor
from robogauntlet.adapters.scene_control import Light, unit

POWER = 2.2
"""A pixel value is SAPIEN's light to the power of 1 / POWER."""
SHINES = np.array([1.0, 0.0, 0.0])
"""Direction in which SAPIEN's directional lamps shine, in their own frame."""


class ManiSkillLights:
    """`Lights` of `scene_control`.

    The key light is the first of two equally bright lamps, which shines at an angle; the other shines straight down.
    """

    def __init__(self, env: Any, base_from_world: Any, usual: float) -> None:
        """Take ManiSkill's environment, SAPIEN's pose of the world in the base frame, and a usual pixel value."""
        self._env, self._usual = env, usual
        self._base_from_world = Rotation.from_quat(wxyz_to_xyzw(base_from_world.q))
        self._ambient = self._system.ambient_light
        self._own = [(lamp.color, lamp.entity_pose) for lamp in self._system.lights]
        self._key = int(np.argmax([np.sum(colour) for colour, _ in self._own]))
        self._changed = False

    def undo(self) -> None:
        """Restore the light."""
        if self._changed:
            self._shine(np.ones(3))
            self._key_lamp.entity_pose = self._own[self._key][1]
            self._changed = False

    @cached_property
    def _own_light(self) -> Light:
        """The light before the first change. It is computed then, since it imports colour science."""
        return self.light()

    def light(self) -> Light:
        """Return the present light of the key lamp, from SAPIEN."""
        lamp = self._key_lamp
        shines = Rotation.from_quat(wxyz_to_xyzw(lamp.entity_pose.q)).apply(SHINES)
        factor = np.asarray(lamp.color, np.float64) / self._own[self._key][0]
        return Light(gain_of(factor ** (1 / POWER), self._usual), unit(-self._base_from_world.apply(shines)))

    def set_light(self, light: Light) -> None:
        """Set the light, until the next reset. The original light is restored exactly."""
        import sapien

        own = self._own_light
        if np.array_equal(light.gain, own.gain) and np.array_equal(light.direction, own.direction):
            self.undo()  # A pose computed from the direction would differ in the last bits.
            return
        self._changed = True
        self._shine(pixel_factor(light.gain, self._usual) ** POWER)
        shines = -self._base_from_world.inv().apply(unit(light.direction))
        lamp = self._key_lamp
        lamp.entity_pose = sapien.Pose(lamp.entity_pose.p, sapien.math.shortest_rotation(SHINES, shines))

    def _shine(self, factor: FloatArray) -> None:
        """Scale all lamps and the ambient light."""
        self._system.ambient_light = self._ambient * factor
        for lamp, (colour, _) in zip(self._system.lights, self._own, strict=True):
            lamp.color = colour * factor

    @property
    def _system(self) -> Any:
        return self._env.scene.sub_scenes[0].render_system

    @property
    def _key_lamp(self) -> Any:
        return self._system.lights[self._key]
