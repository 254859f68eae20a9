"""The policy of one MergeVLA network, or of one network per task."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from robogauntlet.adapters.catalog import original
from robogauntlet.adapters.contract import FloatArray, Observation
from robogauntlet.policies.contract import (
    Decision,
    PolicyError,
    Query,
    StatelessPolicy,
)
from robogauntlet.suites.episode import Episode
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.text import counted
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_folded
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.network.model import MergeVLA
from robogauntlet_mergevla.network.model_cache import ModelCache
from robogauntlet_mergevla.network.normalisation import TaskStatistics, padded
from robogauntlet_mergevla.network.tokenizer import Prompts, Tokenizer, tokenizer_for
from robogauntlet_mergevla.options import CPU
from robogauntlet_mergevla.spec import experts_spec, policy_spec

LARGEST_BATCH = 32
"""Queries in one forward pass."""
Key = TypeVar("Key", bound=Hashable)


def stack_images(observations: Sequence[Observation], cameras: Sequence[str]) -> Tensor:
    """Return images as (B, cameras, 3, H, W) in [0, 1], float32. Raises PolicyError for images of several sizes."""
    frames = [observation.images[camera] for observation in observations for camera in cameras]
    sizes = sorted({frame.shape for frame in frames})
    if len(sizes) > 1:
        raise PolicyError(f"expected images of one size, got {sizes[0]} and {sizes[1]}")
    pixels = torch.from_numpy(np.stack(frames)).permute(0, 3, 1, 2).float() / 255.0
    return pixels.unflatten(0, (len(observations), len(cameras)))


def observed(queries: Sequence[Query]) -> list[Observation]:
    """Return the queries' observations. Raises PolicyError if a query has none."""
    observations = [query.observation for query in queries if query.observation is not None]
    if len(observations) != len(queries):
        raise PolicyError("expected an observation in each query, got a query without one")
    return observations


def device_named(name: str) -> torch.device:
    """Return a device. Raises PolicyError for a GPU that is not there."""
    gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    device = torch.device(name)
    if device.type == "cuda" and (device.index or 0) >= gpus:
        raise PolicyError(
            f"device: expected one of {counted(gpus, 'GPU')} that torch {torch.__version__} finds, got {name}"
        )
    return device


@dataclass(frozen=True, eq=False)
class Network:
    """A network without adapters, the statistics of its training data, and its tokenizer."""

    model: MergeVLA
    statistics: TaskStatistics
    tokenizer: Tokenizer
    action_steps: int | None = None
    """See `CheckpointMetadata.action_steps`."""

    @torch.inference_mode()
    def chunks(self, observations: Sequence[Observation], tasks: Sequence[str]) -> FloatArray:
        """Return the actions for B observations, by one forward pass, shape (B, n, numbers), in the contract's units.

        n is `action_steps`, or the chunk's length; the numbers are the network's. `tasks` names the statistics for each
        observation. Raises PolicyError for observations that do not fit the network, or a task without statistics.
        """
        device = next(self.model.parameters()).device
        images = stack_images(observations, self.model.architecture.cameras).to(device)
        prompts: Prompts = self.tokenizer([observation.instruction for observation in observations])
        numbers = self.model.architecture.proprioception_dim
        states = np.stack([padded(observation.proprioception, numbers) for observation in observations])
        normalised = self.statistics.normalise_proprioception(tasks, states)
        proprioception = torch.from_numpy(normalised).float().to(device)
        chunks = self.model(images, prompts.to(device), proprioception)
        return self.statistics.restore_actions(tasks, chunks[:, : self.action_steps].double().cpu().numpy())


def load_network(reference: str | Path, device: torch.device) -> Network:
    """Load the network of a checkpoint, a folder or a hub id, in evaluation mode."""
    checkpoint = load_folded(reference)
    model, metadata = checkpoint.model.to(device), checkpoint.metadata
    return Network(model, metadata.statistics, tokenizer_for(model.architecture), metadata.action_steps)


def chunks_by(
    observations: Sequence[Observation], tasks: Sequence[str], keys: Sequence[Key], network: Callable[[Key], Network]
) -> list[FloatArray]:
    """Return an action chunk for each observation, in order, of its own numbers; each network runs in its own batches.

    Args:
        observations: Observations.
        tasks: Task whose statistics are used, for each observation.
        keys: Key of the network that acts, for each observation.
        network: Returns the network of a key.
    """
    answers: dict[int, FloatArray] = {}
    for key in dict.fromkeys(keys):
        places = [place for place, other in enumerate(keys) if other == key]
        for start in range(0, len(places), LARGEST_BATCH):
            batch = places[start : start + LARGEST_BATCH]
            chunks = network(key).chunks([observations[place] for place in batch], [tasks[place] for place in batch])
            answers |= {
                place: chunk[:, : observations[place].action_dim] for place, chunk in zip(batch, chunks, strict=True)
            }
    return [answers[place] for place in range(len(observations))]


class MergeVLAPolicy(StatelessPolicy):
    """Acts by one network, or by the network of the episode's task. Uses one thread, as one worker of many."""

    def __init__(self, checkpoints: Path | Mapping[str, Path], *, device: str = CPU) -> None:
        """Take one checkpoint for all tasks, or a folder for each task, read when the task first occurs.

        Raises PolicyError if a checkpoint cannot be used, if their specs differ, or without the device.
        """
        place = device_named(device)
        torch.set_num_threads(1)
        self._checkpoints = checkpoints
        self._network: ModelCache[Path, Network] = ModelCache(
            partial(load_network, device=place),
            lambda network: network.model.state_dict().values(),
            device=place,
        )
        if isinstance(checkpoints, Path):
            network = self._network(checkpoints)
            self.spec = policy_spec(network.model.architecture, network.statistics.action_dims)
            return
        self.spec = experts_spec({task: CheckpointMetadata.read(folder) for task, folder in checkpoints.items()})

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Refuse episodes of a task without a checkpoint."""
        for episode in episodes:
            self._checkpoint(episode.task)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return a chunk for each query; an answer does not depend on the rest of its batch (within 1e-5)."""
        observations, tasks = observed(queries), [query.episode.task for query in queries]
        folders = [self._checkpoint(task) for task in tasks]
        return [Decision(chunk) for chunk in chunks_by(observations, tasks, folders, self._network)]

    def _checkpoint(self, task: str) -> Path:
        if isinstance(self._checkpoints, Path):
            return self._checkpoints
        own = original(task)
        if own not in self._checkpoints:
            raise PolicyError(
                f"expected a task that has an expert, got '{task}'{did_you_mean(task, self._checkpoints)}"
            )
        return self._checkpoints[own]
