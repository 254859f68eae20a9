"""Illuminance, colour temperature and direction of light, measured in images and read back from the simulator."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray, NotDelivered
from robogauntlet.adapters.photometry import channel_gains, stops, temperature_gains, temperature_of
from robogauntlet.adapters.scene_control import Light, Lights, unit
from robogauntlet.orchestrator.perturbations.base import ImagePairs, PerturbedScene

LEAST_LIT = 0.01
"""Share of the pixels that must show a change of light for it to be measured."""
LOWEST = math.radians(10.0)
"""The least height of the key light above the horizon."""
DRAWS = 1000


class PerturbedLight(PerturbedScene):
    """Another light from the reset on."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then change the light.

        Raises:
            UnsupportedCondition: This simulation's light cannot be changed.
        """
        super().reset(seed)
        self._lights: Lights = self.offered(self.scene_controls.lights, "its light be changed")
        self._own = self._lights.light()
        self._other = self.other(self._own)
        self._lights.set_light(self._other)

    def other(self, own: Light) -> Light:
        """The other light."""
        raise NotImplementedError

    def show_clean(self) -> None:
        """Give the scene its own light."""
        self._lights.set_light(self._own)

    def show_perturbed(self) -> None:
        """And the other again."""
        self._lights.set_light(self._other)


class Relit(PerturbedLight):
    """Lamps of another strength or colour."""

    def other(self, own: Light) -> Light:
        """The same lamps with another gain."""
        return Light(own.gain * self.gain(), own.direction)

    def gain(self) -> FloatArray:
        """Factor (3,) of the linear light."""
        raise NotImplementedError

    def value(self, gains: FloatArray) -> float:
        """What factors of the linear light (3,) amount to, in the unit of the axis."""
        raise NotImplementedError

    def measured(self, looks: ImagePairs) -> tuple[float, dict[str, float]]:
        """From the pixels of all cameras that tell of the light."""
        gains, lit = channel_gains([looks[camera] for camera in sorted(looks)])
        if lit < LEAST_LIT:
            raise NotDelivered(
                f"{self.episode.condition}: expected other light, {100 * (1 - lit):.1f} % stays the same"
            )
        named = dict(zip(("red", "green", "blue"), gains.tolist(), strict=True))
        return self.checked(self.value(gains)), named | {"lit": lit}


class Illuminance(Relit):
    """Less light."""

    def gain(self) -> FloatArray:
        """The same for all colours."""
        return np.full(3, 2.0**-self.level)

    def value(self, gains: FloatArray) -> float:
        """Stops."""
        return -stops(gains)


class ColourTemperature(Relit):
    """Warmer light."""

    def gain(self) -> FloatArray:
        """A black body's, at equal luminance."""
        return temperature_gains(self.level)

    def value(self, gains: FloatArray) -> float:
        """Kelvin."""
        return temperature_of(gains)


class LightDirection(PerturbedLight):
    """Light from elsewhere."""

    def other(self, own: Light) -> Light:
        """The first of many drawn directions that is high enough."""
        for _ in range(DRAWS):
            sideways = unit(np.cross(own.direction, self.generator.standard_normal(3)))
            turned = Rotation.from_rotvec(math.radians(self.level) * sideways).apply(own.direction)
            if turned[2] >= math.sin(LOWEST):
                return Light(own.gain, turned)
        raise NotDelivered(f"{self.episode.condition}: expected a direction above the horizon, found none")

    def measured(self, looks: ImagePairs) -> tuple[float, dict[str, float]]:
        """The angle between the directions (deg), and the share of the pixels that changed."""
        found = self._lights.light().direction
        angle = math.degrees(
            math.atan2(np.linalg.norm(np.cross(found, self._own.direction)), found @ self._own.direction)
        )
        return self.checked(angle), {"lit": self.changed(looks)}
