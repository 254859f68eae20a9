"""What perturbs images and actions alike in every simulator: pure functions on NumPy arrays."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
LARGEST_DEVIATION = 4.0
"""Of the noise, as a share of the range of pixel values: beyond it an image holds nothing but noise."""
BISECTIONS = 24


def generator_for(key: str, *what: int) -> np.random.Generator:
    """Draws that depend on a hash (hexadecimal digits) and whole numbers alone, not on what was drawn before."""
    return np.random.default_rng([int(key, 16), *what])


def psnr(image: Image, reference: Image) -> float:
    """Peak signal-to-noise ratio (dB) of an image against another of the same shape; infinite if they are equal."""
    error = np.mean((image.astype(np.float64) - reference) ** 2)
    return math.inf if error == 0 else 10 * math.log10(255.0**2 / float(error))


def add_noise(image: Image, deviation: float, pattern: NDArray[np.floating]) -> Image:
    """An image with noise, rounded and clipped.

    Args:
        image: Shape (h, w, 3).
        deviation: As a share of the range of pixel values.
        pattern: Standard normal, of the image's shape.
    """
    noisy: Image = np.clip(np.rint(image + 255.0 * deviation * pattern), 0, 255).astype(np.uint8)
    return noisy


def noise_deviation(image: Image, target: float, pattern: NDArray[np.floating]) -> float:
    """The deviation with which `add_noise` gives this peak signal-to-noise ratio (dB), by bisection.

    Clipping takes noise away where an image is saturated, half of it on a white background. So equal deviations are
    unequal disturbances in two simulators, and the ratio is what is held equal.

    Returns:
        The deviation; `LARGEST_DEVIATION` if none is enough.
    """
    low, high = 0.0, LARGEST_DEVIATION
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if psnr(add_noise(image, middle, pattern), image) > target:
            low = middle
        else:
            high = middle
    return high


def blur(image: Image, deviation: float) -> Image:
    """A Gaussian blur, its border repeated.

    Args:
        image: Shape (h, w, 3).
        deviation: In % of the image's width.
    """
    from scipy.ndimage import convolve1d

    kernel = gaussian_kernel(deviation / 100 * image.shape[1])
    smooth = convolve1d(image.astype(np.float64), kernel, axis=0, mode="nearest")
    blurred: Image = np.rint(convolve1d(smooth, kernel, axis=1, mode="nearest")).astype(np.uint8)
    return blurred


def gaussian_kernel(deviation: float) -> NDArray[np.float64]:
    """The Gaussian's counterpart on a grid, e^-t I_n(t) with t the variance, shape (2 r + 1,).

    T. Lindeberg, "Scale-space for discrete signals", IEEE PAMI 12 (1990) 234-254. Its variance is t for any t. A
    Gaussian that is only sampled is a single 1 where the deviation is below a third of a pixel: no blur at all.

    Args:
        deviation: In px.
    """
    from scipy.special import ive

    reach = math.ceil(4 * deviation) + 2
    kernel: NDArray[np.float64] = ive(np.abs(np.arange(-reach, reach + 1)), deviation**2)
    return kernel / kernel.sum()


def is_frozen(look: int, share: float, phase: float) -> bool:
    """Whether a look from 0 on repeats the one before: this share of them (%), evenly spread. The first never does.

    Args:
        look: Number of the look.
        share: In %.
        phase: Where the spreading starts, in [0, 1).
    """
    return look > 0 and math.floor(look * share / 100 + phase) > math.floor((look - 1) * share / 100 + phase)


def delay_steps(delay_ms: float, control_hz: float) -> int:
    """Control steps nearest to a delay, one at least."""
    return max(1, round(delay_ms / 1000 * control_hz))


def step_deviation(spread: float, control_hz: float) -> float:
    """Deviation (m) of each control step's noise so that after a second the sum has deviated by `spread` (cm)."""
    return spread / 100 / math.sqrt(control_hz)
