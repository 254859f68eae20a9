"""Random small shifts of images, so that a policy does not learn pixel positions by heart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adapters.contract import Image


def shift(images: Image, offsets: NDArray[np.int64], largest: int) -> Image:
    """Move each image, its border repeated into what opens up: pad and crop (arXiv 2004.13649).

    Args:
        images: Shape (b, h, w, 3).
        offsets: Rows and columns (px) to move down and right, shape (b, 2), within -largest .. largest.
        largest: Largest offset (px).

    Returns:
        The moved images, same shape.
    """
    if largest == 0:
        return images
    height, width = images.shape[1:3]
    padded = np.pad(images, ((0, 0), (largest, largest), (largest, largest), (0, 0)), mode="edge")
    moved = np.empty_like(images)
    for place, image, (down, right) in zip(moved, padded, offsets.tolist(), strict=True):
        top, left = largest - down, largest - right
        place[:] = image[top : top + height, left : left + width]
    return moved


def random_offsets(generator: np.random.Generator, count: int, largest: int) -> NDArray[np.int64]:
    """Uniform offsets for `shift`, shape (count, 2)."""
    return generator.integers(-largest, largest + 1, size=(count, 2))
