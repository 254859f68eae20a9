"""Random changes of what a network sees in training."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import Image


def shift(images: Image, offsets: NDArray[np.int64], largest: int) -> Image:
    """Shift each image (b, h, w, 3) and repeat its border: pad and crop (arXiv 2004.13649).

    `offsets` are the rows and columns (px) to move down and right, shape (b, 2), within -largest .. largest.
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
