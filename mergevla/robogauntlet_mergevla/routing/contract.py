"""The contract of routers: first observations in, scores of experts out.

Simulator processes, which write first observations, import it: torch and the networks are imported by what uses them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from robogauntlet.adapters.catalog import body_of, original
from robogauntlet.adapters.contract import PROPRIOCEPTION_DIM, FloatArray
from robogauntlet.policies.contract import PolicyError, Routing

if TYPE_CHECKING:
    from torch import Tensor

    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
    from robogauntlet_mergevla.network.backbone import HiddenStates

LARGEST_BATCH = 32
"""Largest number of observations in one pass of a backbone."""


class RoutingError(PolicyError):
    """A router that cannot answer: unknown, not fitted, fitted to other experts, or given other observations."""


@dataclass(frozen=True, eq=False)
class FirstObservation:
    """The first observation of one episode."""

    images: Tensor
    """Shape (cameras, 3, H, W), in [0, 1]."""
    instruction: str
    proprioception: FloatArray
    """Shape (8 * arms,), or that of a task with joints, in the units of `robogauntlet.adapters.contract`."""
    episode_id: str
    """Key of all randomness."""
    task: str
    """The true task (`simulator/task`), which only the oracle router may read."""

    def __post_init__(self) -> None:
        images, state = self.images, self.proprioception
        if images.ndim != 4 or images.shape[1] != 3 or not images.is_floating_point():
            raise RoutingError(
                f"expected images of shape (cameras, 3, H, W) in [0, 1], got {tuple(images.shape)} of {images.dtype}"
            )
        fits = state.ndim == 1 and (
            not len(state) % PROPRIOCEPTION_DIM or len(state) == body_of(self.task).proprioception_dim
        )
        if not fits:
            raise RoutingError(f"expected proprioception of shape ({PROPRIOCEPTION_DIM} * arms,), got {state.shape}")


class Router(Protocol):
    """Infers the task. Without state: a score depends on its own observation alone."""

    @property
    def name(self) -> str:
        """As in `robogauntlet_mergevla.routing.catalog`."""

    @property
    def sees_instruction(self) -> bool:
        """False if the instruction is blanked, so that the task must be inferred from images."""

    def passes(self, experts: int) -> int:
        """Backbone passes for one decision among this number of experts."""

    def route(self, observations: Sequence[FirstObservation], model: MergedModel) -> list[Routing]:
        """Route each observation, in order; the caller sets the latency.

        Raises PolicyError if the router does not fit the observations or the model.
        """


def answer(scores: Mapping[str, float], unknown: float | None = None, threshold: float | None = None) -> Routing:
    """Choose the expert of the highest score, in a tie the first by name. The caller sets the latency."""
    choice = min(scores, key=lambda expert: (-scores[expert], expert))
    rejected = None if unknown is None or threshold is None else unknown > threshold
    return Routing(scores, choice, 0.0, unknown, rejected)


def named_for(routing: Routing, task: str, model: MergedModel) -> Routing:
    """Return a routing in which the expert of `task`, if there is one, has the task's name, as records need it."""
    expert = model.expert_of.get(original(task))
    if expert in (None, task):
        return routing
    scores = {task if name == expert else name: score for name, score in routing.scores.items()}
    return replace(routing, scores=scores, choice=task if routing.choice == expert else routing.choice)


def hidden_states(
    model: MergedModel, expert: str | None, observations: Sequence[FirstObservation], *, sees_instruction: bool
) -> Iterator[HiddenStates]:
    """Yield hidden states of observations, batch by batch; RoutingError for images of another shape."""
    import torch

    architecture = model.architecture
    size = architecture.image_size
    expected = (len(architecture.cameras), 3, size, size)
    for start in range(0, len(observations), LARGEST_BATCH):
        batch = observations[start : start + LARGEST_BATCH]
        for observation in batch:
            if tuple(observation.images.shape) != expected:
                raise RoutingError(f"expected images of shape {expected}, got {tuple(observation.images.shape)}")
        instructions = [observation.instruction if sees_instruction else "" for observation in batch]
        with torch.no_grad():
            hidden = model.hidden_states(expert, torch.stack([s.images for s in batch]), instructions)
        yield hidden


def check_experts(router: str, fitted: Sequence[str], experts: Sequence[str]) -> None:
    """Raise RoutingError if a router was fitted to other tasks than those of the model's experts."""
    differing = sorted(set(fitted) ^ set(experts))
    if differing:
        reason = "the model has no expert of it" if differing[0] in fitted else "the router does not know it"
        raise RoutingError(
            f"router '{router}': expected to be fitted to the experts' tasks, got {differing[0]}: {reason}"
        )
