"""Perturbed images: noise, blur, frozen frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import Delivered, Image, Observation
from robogauntlet.orchestrator.perturbations.base import Perturbed, generator_for

PHASE = 2**32
"""Key of the draw that is made once per episode, besides those of each observation."""
MAX_DEVIATION = 4.0
"""Largest deviation of the noise, as a share of the range of pixel values; beyond it an image is all noise."""
BISECTIONS = 24


class PerturbedImages(Perturbed):
    """Images are changed between simulation and policy. The first ones are compared with the camera's own."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._observations = 0
        """Observations since the reset."""
        self._statistics: dict[str, float] = {}
        """Of each camera's first image: PSNR (dB), mean brightness and share of saturated values."""

    def observe(self) -> Observation:
        """The observation with perturbed images."""
        observation = self.simulation.observe()
        images = {
            camera: self._image(image, number) for number, (camera, image) in enumerate(observation.images.items())
        }
        if self._observations == 0:
            for camera, image in images.items():
                self._statistics[f"psnr_{camera}"] = psnr(image, observation.images[camera])
                self._statistics[f"mean_{camera}"] = float(image.mean())
                self._statistics[f"saturated_{camera}"] = float(((image == 0) | (image == 255)).mean())
        self._observations += 1
        return replace(observation, images=images)

    def delivered(self) -> Delivered:
        """The measured level; no value if the policy did not observe."""
        return Delivered(self._measured() if self._observations else None, self._statistics)

    def _image(self, image: Image, camera: int) -> Image:
        raise NotImplementedError

    def _measured(self) -> float | None:
        return None

    def _ratios(self) -> list[float]:
        """PSNR of each camera's first image (dB)."""
        return [value for name, value in self._statistics.items() if name.startswith("psnr_")]


class SensorNoise(PerturbedImages):
    """Sensor noise. Each camera's first image must have the level's PSNR."""

    def reset(self, seed: int) -> None:
        """Start the episode; the first observation determines the deviations."""
        super().reset(seed)
        self._deviations: dict[int, float] = {}

    def _image(self, image: Image, camera: int) -> Image:
        generator = generator_for(self.episode.pair_id, camera, self._observations)
        pattern = generator.standard_normal(image.shape, dtype=np.float32)
        if camera not in self._deviations:
            self._deviations[camera] = noise_deviation(image, self.level, pattern)
        return add_noise(image, self._deviations[camera], pattern)

    def _measured(self) -> float:
        return float(np.mean([self._checked(ratio) for ratio in self._ratios()]))


class Blur(PerturbedImages):
    """A Gaussian blur, measured by what the first images have lost of their high frequencies."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._first: dict[int, tuple[Image, Image]] = {}

    def _image(self, image: Image, camera: int) -> Image:
        blurred = blur(image, self.level)
        self._first.setdefault(camera, (image, blurred))
        return blurred

    def _measured(self) -> float | None:
        changed = [(own, other) for own, other in self._first.values() if (own != other).any()]
        if not changed and self.must_show:
            raise self._not_delivered("expected blurred images, got what the cameras saw")
        return self._checked(blur_between(changed)) if changed else None


class Blind(PerturbedImages):
    """Black images."""

    def _image(self, image: Image, camera: int) -> Image:
        return np.zeros_like(image)


class FrozenFrames(PerturbedImages):
    """Images that repeat the previous ones in a share of the observations; over few, 0 or far above the level."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._phase = float(generator_for(self.episode.pair_id, PHASE).random())
        self._last: dict[int, Image] = {}
        self._repeated = 0

    def observe(self) -> Observation:
        """The observation with new or repeated images."""
        self._repeated += is_frozen(self._observations, self.level, self._phase)
        return super().observe()

    def _image(self, image: Image, camera: int) -> Image:
        if not is_frozen(self._observations, self.level, self._phase):
            self._last[camera] = image
        return self._last[camera]

    def _measured(self) -> float:
        return 100 * self._repeated / self._observations


def psnr(image: Image, reference: Image) -> float:
    """Peak signal-to-noise ratio (dB) of an image and a reference of the same shape; infinite if they are equal."""
    error = np.mean((image.astype(np.float64) - reference) ** 2)
    return math.inf if error == 0 else 10 * math.log10(255.0**2 / float(error))


def add_noise(image: Image, deviation: float, pattern: NDArray[np.floating]) -> Image:
    """An image (h, w, 3) plus a standard normal pattern times the deviation (share of the range of pixel values)."""
    noisy: Image = np.clip(np.rint(image + 255.0 * deviation * pattern), 0, 255).astype(np.uint8)
    return noisy


def noise_deviation(image: Image, target: float, pattern: NDArray[np.floating]) -> float:
    """The deviation with which `add_noise` gives this PSNR (dB), by bisection; at most `MAX_DEVIATION`.

    Clipping removes noise where an image is saturated, half of it on a white background. Equal deviations would
    therefore be unequal disturbances in two simulators, so the PSNR is the level.
    """
    low, high = 0.0, MAX_DEVIATION
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if psnr(add_noise(image, middle, pattern), image) > target:
            low = middle
        else:
            high = middle
    return high


def blur(image: Image, deviation: float) -> Image:
    """An image (h, w, 3) with a Gaussian blur of this deviation (% of the width); border pixels are repeated."""
    from scipy.ndimage import convolve1d

    kernel = gaussian_kernel(deviation / 100 * image.shape[1])
    smooth = convolve1d(image.astype(np.float64), kernel, axis=0, mode="nearest")
    blurred: Image = np.rint(convolve1d(smooth, kernel, axis=1, mode="nearest")).astype(np.uint8)
    return blurred


def blur_between(pairs: Sequence[tuple[Image, Image]]) -> float:
    """The deviation (% of the width) of the Gaussian blur that explains best what square images (n, n, 3) have become.

    A discrete Gaussian of variance t multiplies the cosine transform by e^-t(2 - cos a - cos b); t is the one with the
    least squared error.
    """
    from scipy.fft import dctn
    from scipy.optimize import minimize_scalar

    width = len(pairs[0][0])
    before, after = dctn(np.array(pairs, dtype=np.float64).swapaxes(0, 1), axes=(2, 3))
    cosine = np.cos(np.pi * np.arange(width) / width)
    decay = (2.0 - cosine[:, None] - cosine)[..., None]

    def error(deviation: float) -> float:
        return float(np.square(after - before * np.exp(-((deviation / 100 * width) ** 2) * decay)).sum())

    return float(minimize_scalar(error, bounds=(0.0, 10.0), method="bounded").x)


def gaussian_kernel(deviation: float) -> NDArray[np.float64]:
    """The discrete Gaussian kernel e^-t I_n(t) of shape (2 r + 1,), t being the square of the deviation (px).

    T. Lindeberg, "Scale-space for discrete signals", IEEE PAMI 12 (1990) 234-254. Its variance is t for any t. A
    sampled Gaussian is a single 1 if the deviation is below a third of a pixel: no blur at all.
    """
    from scipy.special import ive

    reach = math.ceil(4 * deviation) + 2
    kernel: NDArray[np.float64] = ive(np.abs(np.arange(-reach, reach + 1)), deviation**2)
    return kernel / kernel.sum()


def is_frozen(observation: int, share: float, phase: float) -> bool:
    """Whether an observation repeats the previous one. Repeated ones are evenly spread; the first never is.

    Args:
        observation: Number of the observation, from 0.
        share: Share of repeated observations (%).
        phase: Start of the spreading, in [0, 1).
    """
    before, now = (math.floor(number * share / 100 + phase) for number in (observation - 1, observation))
    return observation > 0 and now > before
