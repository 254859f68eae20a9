"""First observations of recorded demonstrations, to fit routers on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from policies.mergevla.routing.contract import RoutingError, Sighting
from policies.training.dataset import Demonstrations
from suites.vocabulary import content_hash

HELD_OUT_EVERY = 4
"""One episode in so many is held out, the last of each four. Training's one in ten is too few for a temperature and a
95 % quantile: an episode has one first frame."""


@dataclass(frozen=True, eq=False)
class FirstSightings:
    """First observations by expert, in two disjoint sets of episodes."""

    frames: Mapping[str, Sequence[Sighting]]
    """To fit classes on."""
    held_out: Mapping[str, Sequence[Sighting]]
    """To fit temperature and thresholds on."""


def first_sightings(datasets: Sequence[Demonstrations], cameras: Sequence[str]) -> FirstSightings:
    """First frames of episodes, of every task as many as the task with the fewest has.

    With more of some tasks than of others, what the classes have in common is mostly theirs, and a task that is left
    out is noticed less: an AUROC of .72 instead of .85 with up to four times as many of five out of nine.

    Args:
        datasets: Of which only the first frames' images are decoded. Those that begin where the oracle took over from a
            learner are left out: no episode that is routed begins there.
        cameras: The architecture's, in its order.

    Raises:
        RoutingError: A dataset without such a camera, or with one episode only, so that none can be held out; a task
            whose datasets all begin late.
        DatasetError: A broken image.
    """
    frames: dict[str, list[Sighting]] = {}
    held_out: dict[str, list[Sighting]] = {}
    whole = [dataset for dataset in datasets if not dataset.begins_late]
    for task in dict.fromkeys(dataset.task for dataset in datasets):
        if task not in {dataset.task for dataset in whole}:
            raise RoutingError(f"expected demonstrations of {task} from their first step, got a learner's only")
    for dataset in whole:
        task = dataset.task
        every = min(HELD_OUT_EVERY, dataset.episodes)
        if every < 2:
            raise RoutingError(f"{dataset.folder}: expected two episodes or more, got {dataset.episodes}")
        for index, sighting in enumerate(_sightings(dataset, task, cameras)):
            part = held_out if index % every == every - 1 else frames
            part.setdefault(task, []).append(sighting)
    return FirstSightings(_balanced(frames), _balanced(held_out))


def _balanced(frames: Mapping[str, Sequence[Sighting]]) -> dict[str, Sequence[Sighting]]:
    fewest = min(map(len, frames.values()), default=0)
    return {task: found[:fewest] for task, found in frames.items()}


def _sightings(dataset: Demonstrations, task: str, cameras: Sequence[str]) -> list[Sighting]:
    missing = [camera for camera in cameras if camera not in dataset.spec.cameras]
    if missing:
        came = ", ".join(sorted(dataset.spec.cameras))
        raise RoutingError(f"{dataset.folder}: expected camera {missing[0]}, got {came}")
    starts = dataset.starts
    batch = dataset.batch(starts, chunk_length=1)
    pixels = np.stack([batch.images[camera] for camera in cameras], axis=1)
    images = torch.from_numpy(pixels).permute(0, 1, 4, 2, 3).float() / 255.0
    return [
        Sighting(images[i], batch.instructions[i], batch.states[i].astype(np.float64), _key(dataset, task, i), task)
        for i in range(len(starts))
    ]


def _key(dataset: Demonstrations, task: str, episode: int) -> str:
    return content_hash({"demonstration": task, "dataset": dataset.folder.name, "episode": episode})
