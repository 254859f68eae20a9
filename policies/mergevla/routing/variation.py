"""First observations made a little different, so that routers do not hang on one wording, light or camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from policies.mergevla.routing.contract import Sighting
from suites.vocabulary import content_hash

BRIGHTNESS = (-1.0, 0.3)
"""Natural logarithm of the factor on all images of a sighting: .37 to 1.35 times as bright."""
TINT = 0.3
"""Largest natural logarithm of the factor on each of the three colours, either way."""
ZOOM = 0.25
"""Largest natural logarithm of the factor on an image's size, either way."""
SHIFT = 0.075
"""Farthest that an image moves along each axis before it is sized, as a share of its side."""


def varied(sightings: Sequence[Sighting], *, sees_instruction: bool) -> list[Sighting]:
    """Each sighting as it is, and beside it what might as well have been seen and said.

    Where a task always comes with the same sentence, a classifier takes the sentence for the task: in other words it is
    lost. Words are left out here, each sighting's own share of them, and images get other light and another frame
    (domain randomisation, J. Tobin et al., arXiv 1703.06907). The same sighting always gives the same.

    Args:
        sightings: First observations.
        sees_instruction: Whether the instruction is read; otherwise only images are varied.

    Returns:
        Four for each sighting, in its place: itself, fewer words, another image, both; or two: itself, another image.
    """
    return [one for sighting in sightings for one in _beside(sighting, sees_instruction=sees_instruction)]


def _beside(sighting: Sighting, *, sees_instruction: bool) -> list[Sighting]:
    generator = np.random.default_rng(int(content_hash({"varied": sighting.episode_id}), 16))
    seen = replace(sighting, images=_other_images(sighting.images, generator))
    if not sees_instruction:
        return [sighting, seen]
    told = [replace(one, instruction=_fewer_words(one.instruction, generator)) for one in (sighting, seen)]
    return [sighting, told[0], seen, told[1]]


def _fewer_words(instruction: str, generator: np.random.Generator) -> str:
    """Each word stays with the same probability, which is drawn first: from nearly all of them to hardly any."""
    kept = generator.random()
    return " ".join(word for word in instruction.split() if generator.random() < kept)


def _other_images(images: Tensor, generator: np.random.Generator) -> Tensor:
    """Light that all cameras share, and a frame that each has for itself; border pixels repeat into what opens up.

    Args:
        images: Shape (cameras, 3, H, W), in [0, 1].
        generator: What is drawn comes from it.

    Returns:
        The same shape and range.
    """
    light = np.exp(generator.uniform(*BRIGHTNESS) + generator.uniform(-TINT, TINT, 3))
    lit = images * torch.tensor(light, dtype=images.dtype, device=images.device)[:, None, None]
    size = np.exp(-generator.uniform(-ZOOM, ZOOM, len(images)))
    moved = 2.0 * generator.uniform(-SHIFT, SHIFT, (len(images), 2))
    frame = np.zeros((len(images), 2, 3))
    frame[:, 0, 0] = frame[:, 1, 1] = size
    frame[:, :, 2] = moved
    grid = functional.affine_grid(torch.tensor(frame, dtype=images.dtype), list(images.shape), align_corners=False)
    return functional.grid_sample(lit, grid.to(images.device), padding_mode="border", align_corners=False).clamp(0, 1)
