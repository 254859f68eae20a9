"""Dims, colours and turns the lamps of ManiSkill's scenes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.photometry import gain_of, pixel_factor
from robogauntlet.adapters.scene_control import Light, unit

USUAL = 153.0
"""A pixel of the usual brightness of these scenes."""
POWER = 2.2
"""A pixel is SAPIEN's light to the power of one over this."""
SHINES = np.array([1.0, 0.0, 0.0])
"""Where SAPIEN's directional lamps shine, in their own frame."""


class ManiSkillLights:
    """See `robogauntlet.adapters.scene_control.Lights`.

    The key light is the first of two equally bright lamps, which shines askew; the other shines straight down.
    """

    def __init__(self, env: Any, base_from_world: Any) -> None:
        """Args: env: ManiSkill's environment; base_from_world: SAPIEN pose."""
        self._env = env
        self._base_from_world = Rotation.from_quat(wxyz_to_xyzw(base_from_world.q))
        self._ambient = self._system.ambient_light
        self._own = [(lamp.color, lamp.pose) for lamp in self._system.lights]
        self._key = int(np.argmax([np.sum(colour) for colour, _ in self._own]))
        self._changed = False
        self._own_light = self.light()

    def undo(self) -> None:
        """Give every lamp its own colour and direction back."""
        if self._changed:
            self._shine(np.ones(3))
            self._key_lamp.pose = self._own[self._key][1]
            self._changed = False

    def light(self) -> Light:
        """The light, as SAPIEN has it: that of the key lamp."""
        lamp = self._key_lamp
        shines = Rotation.from_quat(wxyz_to_xyzw(lamp.pose.q)).apply(SHINES)
        factor = np.asarray(lamp.color, np.float64) / self._own[self._key][0]
        return Light(gain_of(factor ** (1 / POWER), USUAL), unit(-self._base_from_world.apply(shines)))

    def set_light(self, light: Light) -> None:
        """Give the scene another light, until the next reset.

        Its own light comes back to the bit, which a pose computed from a direction would not.
        """
        import sapien

        if np.array_equal(light.gain, self._own_light.gain) and np.array_equal(
            light.direction, self._own_light.direction
        ):
            self.undo()
            return
        self._changed = True
        self._shine(pixel_factor(light.gain, USUAL) ** POWER)
        shines = -self._base_from_world.inv().apply(unit(light.direction))
        lamp = self._key_lamp
        lamp.pose = sapien.Pose(lamp.pose.p, sapien.math.shortest_rotation(SHINES, shines))

    def _shine(self, factor: FloatArray) -> None:
        """Scale all lamps, the ambient one too."""
        self._system.ambient_light = self._ambient * factor
        for lamp, (colour, _) in zip(self._system.lights, self._own, strict=True):
            lamp.color = colour * factor

    @property
    def _system(self) -> Any:
        return self._env.scene.sub_scenes[0].render_system

    @property
    def _key_lamp(self) -> Any:
        return self._system.lights[self._key]
