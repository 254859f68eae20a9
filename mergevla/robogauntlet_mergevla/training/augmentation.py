"""Random changes of what a network sees in training."""

from __future__ import annotations

import string
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import Image

LETTERS = list(string.ascii_lowercase)


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


def change_words(instructions: Sequence[str], generator: np.random.Generator, share: float) -> tuple[str, ...]:
    """Leave out, replace or follow by another this share of the words, each as often; the others are random letters.

    As J. Wei and K. Zou do (EDA, arXiv 1901.11196), without synonyms: evaluations have sentences of their own.
    """
    return tuple(" ".join(_changed(text.split(), generator, share)) for text in instructions)


def _changed(words: Sequence[str], generator: np.random.Generator, share: float) -> list[str]:
    result: list[str] = []
    for word, drawn in zip(words, generator.random(len(words)).tolist(), strict=True):
        if not share / 3 <= drawn < share:
            result.append(word)
        if drawn < 2 * share / 3:
            result.append("".join(generator.choice(LETTERS, 5)))
    return result
