"""LIBERO-Plus's image noise: five kinds at ten levels each, after ImageNet-C (arXiv 1903.12261). Pure functions.

Lengths are in pixels of an image of 256 px, the size in published evaluations. The random draws come from a generator.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, zoom

from robogauntlet.adapters.contract import Image

SIZE = 256
"""Height and width of the images for which the levels are defined (px)."""
LEVELS = 10
Floats = NDArray[np.float64]

MOTION = ((5, 2), (8, 3), (10, 4), (12, 5), (15, 6), (18, 8), (20, 10), (25, 12), (30, 15), (35, 20))
"""Length and standard deviation (px)."""
STEEPEST = 45.0
"""Largest angle of the motion with the horizontal (deg)."""
ZOOMS = (
    *((1.11, 0.01), (1.16, 0.01), (1.21, 0.02), (1.26, 0.02), (1.31, 0.03)),
    *((1.36, 0.01), (1.41, 0.01), (1.46, 0.02), (1.51, 0.02), (1.56, 0.03)),
)
"""End, which is left out, and step of the factors, from 1."""
FOG = (
    *((0.5, 3.0), (1.0, 2.8), (1.5, 2.5), (2.0, 2.2), (2.5, 2.0)),
    *((3.0, 1.8), (3.5, 1.6), (4.0, 1.5), (4.5, 1.4), (5.0, 1.3)),
)
"""Density, and how quickly smaller clouds become fainter."""
GLASS = (
    *((0.5, 1, 3), (0.7, 1, 3), (0.9, 2, 3), (1.0, 2, 2), (1.1, 3, 2)),
    *((1.3, 3, 2), (1.5, 4, 2), (1.8, 4, 2), (2.2, 5, 1), (2.5, 5, 1)),
)
"""Standard deviation of the blur (px), largest displacement (px), and repetitions."""
GLASS_EDGE = 224
"""Row and column from which on pixels are not displaced."""


def noisy(image: Image, number: int, generator: np.random.Generator) -> Image:
    """Return an image (256, 256, 3) with noise 1 to 50: ten levels of `KINDS`, one kind after the other.

    The image is as LIBERO's environment gives it, upside down.
    """
    kind, level = divmod(number - 1, LEVELS)
    _, function = KINDS[kind]
    return np.clip(function(image.astype(np.float64) / 255.0, level, generator) * 255.0, 0, 255).astype(np.uint8)


def describe(number: int) -> str:
    """Return kind and level of a noise, such as `fog 3`."""
    kind, level = divmod(number - 1, LEVELS)
    return f"{KINDS[kind][0]} {level + 1}"


def motion_blur(image: Floats, level: int, generator: np.random.Generator) -> Floats:
    """Blur along a line to one side, with half a Gaussian, as ImageMagick does."""
    length, deviation = MOTION[level]
    angle = math.radians(generator.uniform(-STEEPEST, STEEPEST))
    along = np.arange(2 * length + 1)
    weights = np.exp(-(along**2) / (2.0 * deviation**2))
    columns = np.ceil(along * math.cos(angle) - 0.5).astype(int)
    rows = np.ceil(along * math.sin(angle) - 0.5).astype(int)
    there = np.arange(image.shape[0])
    blurred = np.zeros_like(image)
    for weight, row, column in zip(weights / weights.sum(), rows, columns, strict=True):
        inside = [np.clip(there + shift, 0, len(there) - 1) for shift in (row, column)]
        blurred += weight * image[np.ix_(*inside)]
    return (np.round(blurred * 255.0) + 0.25) / 255.0  # Rounded, as ImageMagick does; `noisy` truncates.


def gaussian_blur(image: Floats, level: int, generator: np.random.Generator) -> Floats:
    """Blur by as many pixels as the level."""
    return _blurred(image, level + 1.0)


def zoom_blur(image: Floats, level: int, generator: np.random.Generator) -> Floats:
    """Average the image and its enlargements about the centre."""
    end, step = ZOOMS[level]
    source = image.astype(np.float32)
    enlarged = [_enlarged(source, factor) for factor in np.arange(1, end, step)]
    mean: Floats = np.sum([source, *enlarged], axis=0) / (len(enlarged) + 1)
    return mean


def fog(image: Floats, level: int, generator: np.random.Generator) -> Floats:
    """Add clouds: a random fractal (diamond-square)."""
    density, decay = FOG[level]
    brightest = image.max()
    clouds = image + density * _fractal(image.shape[0], decay, generator)[..., None]
    mixed: Floats = clouds * brightest / (brightest + density)
    return np.clip(mixed, 0.0, 1.0)


def glass_blur(image: Floats, level: int, generator: np.random.Generator) -> Floats:
    """Replace pixels by random neighbours, between two blurs.

    LIBERO-Plus means to swap neighbours, but its code copies one over the other, and so does this.
    """
    deviation, reach, repetitions = GLASS[level]
    blurred = np.floor(_blurred(image, deviation) * 255.0) / 255.0
    size = image.shape[0]
    source = list(range(size * size))
    there = range(GLASS_EDGE - reach, reach, -1)
    for _ in range(repetitions):
        shifts = generator.integers(-reach, reach, size=(len(there) ** 2, 2)) @ (1, size)
        moves = iter(shifts.tolist())
        for row in there:
            for column in there:
                pixel = row * size + column
                source[pixel] = source[pixel + next(moves)]
    return _blurred(blurred.reshape(-1, 3)[source].reshape(image.shape), deviation)


KINDS: tuple[tuple[str, Callable[[Floats, int, np.random.Generator], Floats]], ...] = (
    ("motion blur", motion_blur),
    ("Gaussian blur", gaussian_blur),
    ("zoom blur", zoom_blur),
    ("fog", fog),
    ("glass blur", glass_blur),
)
"""Kinds of noise in the order of their numbers."""


def _blurred(image: Floats, deviation: float) -> Floats:
    return np.asarray(gaussian_filter(image, (deviation, deviation, 0.0), mode="nearest", truncate=4.0))


def _enlarged(image: NDArray[np.float32], factor: float) -> NDArray[np.float32]:
    """Return the centre of an image, enlarged to its size."""
    size = image.shape[0]
    part = math.ceil(size / factor)
    start = (size - part) // 2
    large = zoom(image[start : start + part, start : start + part], (factor, factor, 1), order=1)
    edge = (large.shape[0] - size) // 2
    return np.asarray(large[edge : edge + size, edge : edge + size])


def _fractal(size: int, decay: float, generator: np.random.Generator) -> Floats:
    """Return a random periodic surface (size, size) from 0 to 1, by the diamond-square algorithm."""
    surface: Floats = np.zeros((size, size))
    amplitude, step = 100.0, size
    while step >= 2:
        half = step // 2
        corners: Floats = surface[::step, ::step]
        sums = corners + np.roll(corners, -1, axis=0)
        sums = sums + np.roll(sums, -1, axis=1)
        surface[half::step, half::step] = _disturbed(sums, amplitude, generator)
        centres: Floats = surface[half::step, half::step]
        across = centres + np.roll(centres, 1, axis=0) + corners + np.roll(corners, -1, axis=1)
        surface[::step, half::step] = _disturbed(across, amplitude, generator)
        along = centres + np.roll(centres, 1, axis=1) + corners + np.roll(corners, -1, axis=0)
        surface[half::step, ::step] = _disturbed(along, amplitude, generator)
        step, amplitude = half, amplitude / decay
    surface -= surface.min()
    return np.asarray(surface / surface.max())


def _disturbed(sums: Floats, amplitude: float, generator: np.random.Generator) -> Floats:
    return np.asarray(sums / 4.0 + amplitude * generator.uniform(-amplitude, amplitude, sums.shape))
