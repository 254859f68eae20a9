"""Illuminance, colour temperature and direction of light, measured in images and read back from the simulator."""

from __future__ import annotations

import math

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.photometry import channel_gains, stops, temperature_gains, temperature_of
from robogauntlet.adapters.scene_control import Light, unit
from robogauntlet.orchestrator.perturbations.base import ImagePairs, PerturbedScene

MIN_LIT = 0.01
"""Share of the pixels that must show a change of light for it to be measured."""
MIN_ELEVATION = math.radians(10.0)
"""Smallest elevation of the key light above the horizon (rad)."""
DRAWS = 1000


class PerturbedLight(PerturbedScene):
    """Another light from the reset on."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then change the light.

        Raises:
            UnsupportedCondition: This simulation's light cannot be changed.
        """
        super().reset(seed)
        self._lights = self._required(self.scene_controls.lights, "its light be changed")
        self._own = self._lights.light()
        self._other = self._changed(self._own)
        self._show(perturbed=True)

    def _show(self, *, perturbed: bool) -> None:
        self._lights.set_light(self._other if perturbed else self._own)

    def _changed(self, own: Light) -> Light:
        raise NotImplementedError


class PerturbedGain(PerturbedLight):
    """Lamps of another strength or colour."""

    def _gain(self) -> FloatArray:
        """Factor (3,) of the linear light."""
        raise NotImplementedError

    def _level_of(self, gains: FloatArray) -> float:
        """The level of factors (3,) of the linear light, in the unit of the axis."""
        raise NotImplementedError

    def _changed(self, own: Light) -> Light:
        return Light(own.gain * self._gain(), own.direction)

    def _measured(self, pairs: ImagePairs) -> tuple[float | None, dict[str, float]]:
        gains, lit = channel_gains([pairs[camera] for camera in sorted(pairs)])
        if self.severity < 1:  # eight bits may not show it
            return (self._level_of(gains) if np.isfinite(gains).all() else None), {"lit": lit}
        if lit < MIN_LIT:
            raise self._not_delivered(f"expected other light, {100 * (1 - lit):.1f} % stays the same")
        named = dict(zip(("red", "green", "blue"), gains.tolist(), strict=True))
        return self._checked(self._level_of(gains)), named | {"lit": lit}


class Illuminance(PerturbedGain):
    """Less light, by the same factor for all colours."""

    def _gain(self) -> FloatArray:
        return np.full(3, 2.0**-self.level)

    def _level_of(self, gains: FloatArray) -> float:
        return -stops(gains)


class ColourTemperature(PerturbedGain):
    """Warmer light: that of a black body, with equal luminance."""

    def _gain(self) -> FloatArray:
        return temperature_gains(self.level)

    def _level_of(self, gains: FloatArray) -> float:
        return temperature_of(gains)


class LightDirection(PerturbedLight):
    """Light from another direction: the first of many draws that is high enough; measured by the angle (deg)."""

    def _changed(self, own: Light) -> Light:
        from scipy.spatial.transform import Rotation  # slow, and not every worker needs it

        for _ in range(DRAWS):
            sideways = unit(np.cross(own.direction, self.generator.standard_normal(3)))
            turned = Rotation.from_rotvec(math.radians(self.level) * sideways).apply(own.direction)
            if turned[2] >= math.sin(MIN_ELEVATION):
                return Light(own.gain, turned)
        raise self._not_delivered("expected a direction above the horizon, found none")

    def _measured(self, pairs: ImagePairs) -> tuple[float, dict[str, float]]:
        own, now = self._own.direction, self._lights.light().direction
        angle = math.degrees(math.atan2(np.linalg.norm(np.cross(now, own)), now @ own))
        return self._checked(angle), {"lit": self._changed_share(pairs)}
