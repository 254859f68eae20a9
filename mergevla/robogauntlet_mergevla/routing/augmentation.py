"""Augmentation of first observations, so that routers do not depend on one wording, light or camera pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from robogauntlet.suites.episode import content_hash
from robogauntlet_mergevla.routing.contract import FirstObservation

BRIGHTNESS = (-1.0, 0.3)
"""Range of the natural logarithm of the brightness factor on all images: .37 to 1.35 times as bright."""
TINT = 0.3
"""Largest absolute natural logarithm of the factor on each of the three colours."""
ZOOM = 0.25
"""Largest absolute natural logarithm of the factor on an image's size."""
SHIFT = 0.075
"""Largest shift of an image along each axis before it is scaled, as a share of its side."""


def augmented(observations: Sequence[FirstObservation], *, sees_instruction: bool) -> list[FirstObservation]:
    """Return each observation followed by its augmented variants.

    A classifier that always sees a task with one sentence takes that sentence for the task and fails on a paraphrase.
    Therefore a random share of an observation's words is left out, and its images get other light and another frame
    (domain randomisation, J. Tobin et al., arXiv 1703.06907). The variants depend only on the episode's id.

    Returns:
        Four per observation: itself, fewer words, other images, both. If the instruction is not read, two: itself,
        other images.
    """
    variants = []
    for observation in observations:
        generator = np.random.default_rng(int(content_hash({"varied": observation.episode_id}), 16))
        for variant in (observation, replace(observation, images=_other_images(observation.images, generator))):
            variants.append(variant)
            if sees_instruction:
                variants.append(replace(variant, instruction=_fewer_words(variant.instruction, generator)))
    return variants


def _fewer_words(instruction: str, generator: np.random.Generator) -> str:
    """Keep each word with one probability, drawn uniformly first."""
    kept = generator.random()
    return " ".join(word for word in instruction.split() if generator.random() < kept)


def _other_images(images: Tensor, generator: np.random.Generator) -> Tensor:
    """Change the light of all images (cameras, 3, H, W), in [0, 1], alike, and the frame of each on its own.

    Border pixels fill the uncovered area.
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
