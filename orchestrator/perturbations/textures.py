"""Patterns for painted surfaces: pure functions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SIZE = 64
"""Texels along each side."""
SQUARES = 12
"""Of a chequered surface, along each side."""
BLOTCH = 2.5
"""Deviation (texels) of the blur that makes blotches of noise."""
CONTRAST = 0.7
"""Of a pattern, as a share of the most that its mean colour allows."""
PATTERNS = ("plain", "plain", "gradient", "chequered", "blotches")
"""At severity 1 to 5."""


def pattern(name: str, generator: np.random.Generator) -> Floats:
    """A pattern (SIZE, SIZE, 3) with values from -1 to 1 and mean 0 in each channel.

    Args:
        name: Out of `PATTERNS`.
        generator: Draws the gradient's direction and the blotches.
    """
    rows, columns = np.indices((SIZE, SIZE))
    if name == "plain":
        values = np.zeros((SIZE, SIZE, 1))
    elif name == "gradient":
        angle = generator.uniform(0.0, 2 * math.pi)
        values = (rows * math.sin(angle) + columns * math.cos(angle))[..., None]
    elif name == "chequered":
        values = np.where((rows * SQUARES // SIZE + columns * SQUARES // SIZE) % 2, 1.0, -1.0)[..., None]
    else:
        from scipy.ndimage import gaussian_filter

        noise = generator.standard_normal((SIZE, SIZE, 3))
        values = np.sign(gaussian_filter(noise, (BLOTCH, BLOTCH, 0), mode="wrap"))
    values = values - values.mean(axis=(0, 1))
    return np.broadcast_to(values / max(1.0, float(np.abs(values).max())), (SIZE, SIZE, 3))


def painted(colour: Floats, values: Floats) -> Floats:
    """Reflectances (n, n, 3) from 0 to 1: a mean colour (3,) with as much of a pattern as it has room for."""
    room = CONTRAST * np.minimum(colour, 1.0 - colour)
    return np.asarray(colour + room * values, dtype=np.float64)
