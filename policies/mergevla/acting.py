"""A MergeVLA network that acts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

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


def observed(queries: Sequence[Query]) -> list[Observation]:
    """The queries' observations.

    Raises:
        PolicyError: A query has none.
    """
    observations = [query.observation for query in queries if query.observation is not None]
    if len(observations) != len(queries):
        raise PolicyError("expected an observation in each query, got a query without one")
    return observations


def device_here() -> torch.device:
    """Where networks run: on the GPU if there is one."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


@dataclass(frozen=True, eq=False)
class Network:
    """A network and what it takes to ask it."""

    model: MergeVLA
    """Without adapters."""
    statistics: TaskStatistics
    """Of its training data."""
    tokenizer: Tokenizer
    """The architecture's."""
    action_steps: int | None = None
    """See `Card.action_steps`."""

    @torch.inference_mode()
    def chunks(self, observations: Sequence[Observation], tasks: Sequence[str]) -> FloatArray:
        """What to execute for each observation, by one forward pass, shape (B, n, 7), in the contract's units.

        n is `action_steps`, or the chunk's length.

        Args:
            observations: What is seen.
            tasks: Whose statistics to use, one for each observation.

        Raises:
            PolicyError: Observations that the network was not made for, or a task without statistics.
        """
        device = next(self.model.parameters()).device
        images = stack_images(observations, self.model.architecture.cameras).to(device)
        prompts: Prompts = self.tokenizer([observation.instruction for observation in observations])
        seen = np.stack([observation.proprioception for observation in observations])
        normalised = self.statistics.normalise_proprioception(tasks, seen)
        proprioception = torch.from_numpy(normalised).float().to(device)
        chunks = self.model(images, prompts.to(device), proprioception)
        return self.statistics.restore_actions(tasks, chunks[:, : self.action_steps].double().cpu().numpy())


def load_network(reference: str | Path, device: torch.device) -> Network:
    """The network of a checkpoint, a folder or a hub id, in evaluation mode.

    Raises:
        PolicyError: It cannot be used.
    """
    checkpoint = load_checkpoint(reference)
    model = folded(checkpoint.model) if has_lora(checkpoint.model) else checkpoint.model
    card, tokenizer = checkpoint.card, tokenizer_for(model.architecture)
    return Network(model.eval().to(device), card.statistics, tokenizer, card.action_steps)


def chunks_by(
    observations: Sequence[Observation],
    experts: Sequence[str],
    chunks: Callable[[str, Sequence[Observation]], FloatArray],
) -> list[FloatArray]:
    """An action chunk for each observation, in order, each expert's in batches of their own.

    Args:
        observations: What is seen.
        experts: Who is to act, one for each observation.
        chunks: What an expert answers to a batch of at most `LARGEST_BATCH`.
    """
    answers: dict[int, FloatArray] = {}
    for expert in dict.fromkeys(experts):
        own = [index for index, name in enumerate(experts) if name == expert]
        for start in range(0, len(own), LARGEST_BATCH):
            part = own[start : start + LARGEST_BATCH]
            answers |= dict(zip(part, chunks(expert, [observations[index] for index in part]), strict=True))
    return [answers[index] for index in range(len(observations))]


class MergeVLAPolicy(StatelessPolicy):
    """Acts by one network. Takes one thread, since a worker is one of many on its machine."""

    def __init__(self, network: Network) -> None:
        """Args: network: One that was trained on several tasks is told the episode's, for the statistics."""
        torch.set_num_threads(1)
        self.spec = policy_spec(network.model.architecture)
        self._network = network

    @classmethod
    def from_checkpoint(cls, reference: str) -> MergeVLAPolicy:
        """The policy of a checkpoint, a folder or a hub id.

        Raises:
            PolicyError: It cannot be used.
        """
        return cls(load_network(reference, device_here()))

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """A chunk for each query, in batches; an answer does not depend on what else is in its batch (within 1e-5)."""
        observations = observed(queries)
        decisions: list[Decision] = []
        for start in range(0, len(observations), LARGEST_BATCH):
            part = slice(start, start + LARGEST_BATCH)
            tasks = [query.episode.task for query in queries[part]]
            decisions += [Decision(chunk) for chunk in self._network.chunks(observations[part], tasks)]
        return decisions
