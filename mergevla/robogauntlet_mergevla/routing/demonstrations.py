"""First observations of recorded demonstrations, to fit routers to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from robogauntlet.policies.training.dataset import Demonstrations
from robogauntlet.suites.episode import content_hash
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError

HELD_OUT_EVERY = 4
"""The last of every four episodes is held out. Training's one in ten is too few for a temperature and a 95 % quantile,
since an episode has one first observation."""


@dataclass(frozen=True, eq=False)
class RouterTrainingSet:
    """First observations by task, in two disjoint sets of episodes."""

    frames: Mapping[str, Sequence[FirstObservation]]
    """Observations to fit the classes to."""
    held_out: Mapping[str, Sequence[FirstObservation]]
    """Observations to fit temperature and thresholds to."""


def first_observations(datasets: Sequence[Demonstrations], cameras: Sequence[str]) -> RouterTrainingSet:
    """Read the first observations of episodes, the same number for each task.

    If some tasks had more, they would dominate the shared covariance, and an unknown task would be detected less often:
    with up to four times as many of five out of nine tasks the AUROC is .72 instead of .85.

    Only the first frames' images are decoded. Datasets whose episodes start where the oracle took over from a learner
    are left out: no routed episode starts there. `cameras` are the architecture's, in order.

    Raises:
        RoutingError: A dataset lacks a camera or has a single episode, or all datasets of a task start midway.
        DatasetError: A broken image.
    """
    frames: dict[str, list[FirstObservation]] = {}
    held_out: dict[str, list[FirstObservation]] = {}
    whole = [dataset for dataset in datasets if not dataset.starts_midway]
    for task in dict.fromkeys(dataset.task for dataset in datasets):
        if task not in {dataset.task for dataset in whole}:
            raise RoutingError(f"expected demonstrations of {task} from their first step, got a learner's only")
    for dataset in whole:
        task = dataset.task
        every = min(HELD_OUT_EVERY, dataset.episodes)
        if every < 2:
            raise RoutingError(f"{dataset.folder}: expected two episodes or more, got {dataset.episodes}")
        for index, observation in enumerate(_first_observations(dataset, cameras)):
            part = held_out if index % every == every - 1 else frames
            part.setdefault(task, []).append(observation)
    return RouterTrainingSet(_balanced(frames), _balanced(held_out))


def _balanced(frames: Mapping[str, Sequence[FirstObservation]]) -> dict[str, Sequence[FirstObservation]]:
    fewest = min(map(len, frames.values()), default=0)
    return {task: observations[:fewest] for task, observations in frames.items()}


def _first_observations(dataset: Demonstrations, cameras: Sequence[str]) -> list[FirstObservation]:
    missing = [camera for camera in cameras if camera not in dataset.spec.cameras]
    if missing:
        cameras_text = ", ".join(sorted(dataset.spec.cameras))
        raise RoutingError(f"{dataset.folder}: expected camera {missing[0]}, got {cameras_text}")
    batch = dataset.batch(dataset.starts, chunk_length=1)
    pixels = np.stack([batch.images[camera] for camera in cameras], axis=1)
    images = torch.from_numpy(pixels).permute(0, 1, 4, 2, 3).float() / 255.0
    task, states = dataset.task, batch.states.astype(np.float64)
    keys = [
        content_hash({"demonstration": task, "dataset": dataset.folder.name, "episode": i}) for i in range(len(states))
    ]
    return [FirstObservation(images[i], batch.instructions[i], states[i], key, task) for i, key in enumerate(keys)]
