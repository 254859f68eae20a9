"""Perturbed images: noise, blur, frozen frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from robogauntlet.adapters.contract import Delivered, Image, NotDelivered, Observation
from robogauntlet.orchestrator.perturbations.base import Perturbed
from robogauntlet.orchestrator.perturbations.operators import (
    add_noise,
    blur,
    generator_for,
    is_frozen,
    noise_deviation,
    psnr,
)

SATURATED = 255
PHASE = 2**32
"""Key of the draw that is made once per episode, beside those of looks."""


class PerturbedImages(Perturbed):
    """ImagePairs are counted from the reset; the first images are measured against what the cameras saw."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._looks = 0
        self._statistics: dict[str, float] = {}

    def observe(self) -> Observation:
        """What the cameras see, perturbed."""
        seen = self.simulation.observe()
        images = {camera: self._image(image, number) for number, (camera, image) in enumerate(seen.images.items())}
        if self._looks == 0:
            self._statistics = image_statistics(images, seen.images)
        self._looks += 1
        return replace(seen, images=images)

    def _image(self, image: Image, camera: int) -> Image:
        raise NotImplementedError


class SensorNoise(PerturbedImages):
    """Sensor noise."""

    def reset(self, seed: int) -> None:
        """Start the episode; deviations are found with the first look."""
        super().reset(seed)
        self._deviations: dict[int, float] = {}

    def _image(self, image: Image, camera: int) -> Image:
        generator = generator_for(self.episode.pair_id, camera, self._looks)
        pattern = generator.standard_normal(image.shape, dtype=np.float32)
        if camera not in self._deviations:
            self._deviations[camera] = noise_deviation(image, self.level, pattern)
        return add_noise(image, self._deviations[camera], pattern)

    def delivered(self) -> Delivered | None:
        """The ratio of the first images; each camera's is held to the level."""
        if not self._statistics:
            return Delivered(None)
        ratios = [value for name, value in self._statistics.items() if name.startswith("psnr_")]
        for ratio in ratios:
            self.checked(ratio)
        return Delivered(float(np.mean(ratios)), self._statistics)


class Blur(PerturbedImages):
    """A blur."""

    def _image(self, image: Image, camera: int) -> Image:
        return blur(image, self.level)

    def delivered(self) -> Delivered | None:
        """The deviation, once some image has changed by it: one without any edge cannot."""
        if not self._statistics:
            return Delivered(None)
        if all(math.isinf(value) for name, value in self._statistics.items() if name.startswith("psnr_")):
            raise NotDelivered(f"{self.episode.condition}: expected blurred images, got what the cameras saw")
        return Delivered(self.level, self._statistics)


class Blind(PerturbedImages):
    """Nothing to be seen."""

    def _image(self, image: Image, camera: int) -> Image:
        return np.zeros_like(image)

    def delivered(self) -> Delivered | None:
        """That the images were black."""
        return Delivered(self.level if self._statistics else None, self._statistics)


class FrozenFrames(PerturbedImages):
    """Frames that do not change."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._phase = float(generator_for(self.episode.pair_id, PHASE).random())
        self._last: dict[int, Image] = {}
        self._repeated = 0

    def observe(self) -> Observation:
        """What the cameras see, or saw at the last look."""
        self._repeated += is_frozen(self._looks, self.level, self._phase)
        return super().observe()

    def _image(self, image: Image, camera: int) -> Image:
        if not is_frozen(self._looks, self.level, self._phase):
            self._last[camera] = image
        return self._last[camera]

    def delivered(self) -> Delivered | None:
        """The share of looks that repeated the one before; over few looks it is 0 or far above the level."""
        return Delivered(100 * self._repeated / self._looks if self._looks else None, self._statistics)


def image_statistics(images: Mapping[str, Image], seen: Mapping[str, Image]) -> dict[str, float]:
    """Of each camera: ratio to what it saw (dB), mean brightness and share of saturated values."""
    found = {}
    for camera, image in images.items():
        found[f"psnr_{camera}"] = psnr(image, seen[camera])
        found[f"mean_{camera}"] = float(image.mean())
        found[f"saturated_{camera}"] = float(((image == 0) | (image == SATURATED)).mean())
    return found
