"""What a router is given and what it answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from adapters.contract import PROPRIOCEPTION_DIM, FloatArray
from policies.contract import PolicyError
from policies.mergevla.backbone import HiddenStates
from policies.mergevla.config import Architecture

LARGEST_BATCH = 32
"""Sightings in one pass of a backbone."""


class RoutingError(PolicyError):
    """A router that cannot answer: of unknown name, not fitted, fitted to other experts, or shown something else."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """The first observation of one episode."""

    images: Tensor
    """Shape (cameras, 3, H, W), in [0, 1]."""
    instruction: str
    proprioception: FloatArray
    """Shape (8,), in the units of `adapters.contract`."""
    episode_id: str
    """Keys whatever is random."""
    task: str
    """The true task (`simulator/task`), which only the oracle may read."""

    def __post_init__(self) -> None:
        images, seen = self.images, self.proprioception
        if images.ndim != 4 or images.shape[1] != 3 or not images.is_floating_point():
            raise RoutingError(
                f"expected images of shape (cameras, 3, H, W) in [0, 1], got {tuple(images.shape)} of {images.dtype}"
            )
        if seen.shape != (PROPRIOCEPTION_DIM,):
            raise RoutingError(f"expected proprioception of shape ({PROPRIOCEPTION_DIM},), got {seen.shape}")


@dataclass(frozen=True)
class Routed:
    """A router's answer for one sighting."""

    scores: Mapping[str, float]
    """Expert name to score, higher is likelier; natural log-probabilities from calibrated routers."""
    choice: str
    unknown: float | None = None
    """How unlike any known task this is, higher is less like one; None if the router does not say."""
    rejected: bool | None = None
    """Whether `unknown` is above the threshold fitted on known tasks; None without such a threshold."""


class Candidates(Protocol):
    """A merged model as routers see it."""

    @property
    def experts(self) -> tuple[str, ...]:
        """Names of the experts, each the task that it was trained on (`simulator/task`)."""

    @property
    def architecture(self) -> Architecture:
        """Of the base and of all experts."""

    @property
    def instructions(self) -> Mapping[str, str]:
        """Expert name to the instruction that it was trained with."""

    @property
    def kept_blocks(self) -> int:
        """k, the number of last blocks of the action expert that each task keeps for itself."""

    def hidden_states(self, expert: str | None, images: Tensor, instructions: Sequence[str]) -> HiddenStates:
        """Hidden states of the merged model as `expert` runs it; None for the base Theta_0.

        Args:
            expert: Name, or None.
            images: Shape (B, cameras, 3, H, W), in [0, 1].
            instructions: B of them; empty for none.
        """

    def value_weights(self, expert: str) -> tuple[tuple[Tensor, Tensor], ...]:
        """(v_adapter, v_task) of each block of the merged action expert as `expert` runs it, each (width, width)."""

    def own_value_weights(self, expert: str) -> tuple[Tensor, Tensor]:
        """(v_adapter, v_task) of block L - k - 1 (from 0) of the expert before merging.

        Each of shape (n, width). Their leading right singular vectors, as rows, serve as well as the weights.
        """


class Router(Protocol):
    """Infers the task. Keeps nothing from one sighting to the next: a score depends on its own sighting alone."""

    @property
    def name(self) -> str:
        """As in `policies.mergevla.routing.catalog`."""

    @property
    def sees_instruction(self) -> bool:
        """False if the instruction is blanked, so that the task must be inferred from what is seen."""

    def passes(self, experts: int) -> int:
        """Backbone passes for one decision among so many experts."""

    def route(self, sightings: Sequence[Sighting], candidates: Candidates) -> list[Routed]:
        """An answer for each sighting, in order.

        Raises:
            PolicyError: The sightings or the candidates are not what the router was made for.
        """


def answer(scores: Mapping[str, float], unknown: float | None = None, threshold: float | None = None) -> Routed:
    """The expert of the highest score; of several, the first by name, so that their order does not matter."""
    choice = min(scores, key=lambda expert: (-scores[expert], expert))
    rejected = None if unknown is None or threshold is None else unknown > threshold
    return Routed(scores, choice, unknown, rejected)


def hidden_states(
    candidates: Candidates, expert: str | None, sightings: Sequence[Sighting], *, sees_instruction: bool
) -> Iterator[HiddenStates]:
    """Hidden states of sightings, batch by batch.

    Raises:
        RoutingError: Images of another shape than the architecture's.
    """
    architecture = candidates.architecture
    size = architecture.image_size
    expected = (len(architecture.cameras), 3, size, size)
    for start in range(0, len(sightings), LARGEST_BATCH):
        batch = sightings[start : start + LARGEST_BATCH]
        for sighting in batch:
            if tuple(sighting.images.shape) != expected:
                raise RoutingError(f"expected images of shape {expected}, got {tuple(sighting.images.shape)}")
        instructions = [sighting.instruction if sees_instruction else "" for sighting in batch]
        with torch.no_grad():
            hidden = candidates.hidden_states(expert, torch.stack([s.images for s in batch]), instructions)
        yield hidden


def check_experts(router: str, fitted: Sequence[str], candidates: Sequence[str]) -> None:
    """Refuse a router that was fitted to other experts than the model's.

    Raises:
        RoutingError: They differ.
    """
    differing = sorted(set(fitted) ^ set(candidates))
    if differing:
        whose = "the model has no such expert" if differing[0] in fitted else "the router does not know it"
        raise RoutingError(
            f"router '{router}': expected to be fitted to the model's experts, got {differing[0]}: {whose}"
        )
