"""A MergeVLA network that acts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from adapters.contract import FloatArray, Observation
from policies.contract import Decision, PolicyError, PolicySpec, Query, Sees, StatelessPolicy
from policies.mergevla.checkpoint import load_checkpoint
from policies.mergevla.config import Architecture
from policies.mergevla.lora import folded, has_lora
from policies.mergevla.model import MergeVLA
from policies.mergevla.normalisation import TaskStatistics
from policies.mergevla.tokens import Prompts, Tokenizer, tokenizer_for

LARGEST_BATCH = 32
"""Queries in one forward pass."""


def policy_spec(architecture: Architecture) -> PolicySpec:
    """What a network of this architecture needs and produces."""
    return PolicySpec(
        Sees.OBSERVATION,
        chunk_length=architecture.chunk_length,
        action_dim=architecture.action_dim,
        cameras=architecture.cameras,
        image_size=architecture.image_size,
    )


def stack_images(observations: Sequence[Observation], cameras: Sequence[str]) -> Tensor:
    """The observations' images as (B, cameras, 3, H, W) in [0, 1], float32.

    Raises:
        PolicyError: Frames of several sizes.
    """
    frames = [observation.images[camera] for observation in observations for camera in cameras]
    sizes = sorted({frame.shape for frame in frames})
    if len(sizes) > 1:
        raise PolicyError(f"expected images of one size, got {sizes[0]} and {sizes[1]}")
    pixels = torch.from_numpy(np.stack(frames)).permute(0, 3, 1, 2).float() / 255.0
    return pixels.unflatten(0, (len(observations), len(cameras)))


class MergeVLAPolicy(StatelessPolicy):
    """Acts by one network. Takes one thread, since a worker is one of many on its machine."""

    def __init__(self, model: MergeVLA, statistics: TaskStatistics, tokenizer: Tokenizer) -> None:
        """Args: model: without adapters; statistics: of its training data; tokenizer: the architecture's.

        A network that was trained on several tasks is told the episode's, for the statistics.
        """
        torch.set_num_threads(1)
        self.spec = policy_spec(model.architecture)
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self._model = model.eval().to(self._device)
        self._statistics, self._tokenizer = statistics, tokenizer

    @classmethod
    def from_checkpoint(cls, reference: str) -> MergeVLAPolicy:
        """The policy of a checkpoint, a folder or a hub id.

        Raises:
            PolicyError: It cannot be used.
        """
        checkpoint = load_checkpoint(reference)
        model = folded(checkpoint.model) if has_lora(checkpoint.model) else checkpoint.model
        return cls(model, checkpoint.card.statistics, tokenizer_for(model.architecture))

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """A chunk for each query, in batches; an answer does not depend on what else is in its batch (within 1e-5)."""
        observations = [query.observation for query in queries if query.observation is not None]
        if len(observations) != len(queries):
            raise PolicyError("expected an observation in each query, got a query without one")
        decisions: list[Decision] = []
        for start in range(0, len(observations), LARGEST_BATCH):
            part = slice(start, start + LARGEST_BATCH)
            tasks = [query.episode.task for query in queries[part]]
            decisions += [Decision(chunk) for chunk in self._chunks(observations[part], tasks)]
        return decisions

    @torch.inference_mode()
    def _chunks(self, observations: Sequence[Observation], tasks: Sequence[str]) -> FloatArray:
        images = stack_images(observations, self.spec.cameras).to(self._device)
        prompts: Prompts = self._tokenizer([observation.instruction for observation in observations])
        seen = np.stack([observation.proprioception for observation in observations])
        normalised = self._statistics.normalise_proprioception(tasks, seen)
        proprioception = torch.from_numpy(normalised).float().to(self._device)
        chunks = self._model(images, prompts.to(self._device), proprioception)
        return self._statistics.restore_actions(tasks, chunks.double().cpu().numpy())
