"""Several datasets as one source of batches, with some episodes held out. NumPy in, NumPy out, no torch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from policies.mergevla.normalisation import Statistics, TaskStatistics
from policies.training.augmentation import random_offsets, shift
from policies.training.dataset import Batch, Demonstrations, find_datasets, pooled_hash
from policies.training.lerobot import DatasetError

HELD_OUT_EVERY = 10
"""One episode in so many is held out, the last of each ten."""
MOST_HELD_OUT = 128
"""Frames of the held-out episodes that are looked at, per dataset: evenly spread."""


class Pool:
    """Datasets that are trained on together; each has the same share in a batch, however many frames it has."""

    def __init__(self, datasets: Sequence[Demonstrations]) -> None:
        """Args: datasets: of the same cameras and image size.

        Raises:
            DatasetError: There is none, or they differ in cameras or image size.
        """
        if not datasets:
            raise DatasetError("expected at least one dataset, got none")
        self.datasets = tuple(datasets)
        self.cameras, self.image_size = datasets[0].spec.cameras, datasets[0].spec.image_size
        for dataset in datasets:
            if (set(dataset.spec.cameras), dataset.spec.image_size) != (set(self.cameras), self.image_size):
                raise DatasetError(
                    f"{dataset.folder}: expected {self.image_size} px images of {', '.join(self.cameras)} as in "
                    f"{datasets[0].folder}, got {dataset.spec.image_size} px of {', '.join(dataset.spec.cameras)}"
                )
        split = [_split(dataset) for dataset in datasets]
        self._train = [frames for frames, _ in split]
        self._held_out = [frames for _, frames in split]

    @classmethod
    def open(cls, folders: Sequence[Path]) -> Pool:
        """The datasets in these folders, each a dataset or a folder of datasets, with decoded images in memory.

        Raises:
            DatasetError: There is none, or one is broken.
        """
        found = sorted({path.resolve(): path for folder in folders for path in find_datasets(folder)}.values())
        pool = cls([Demonstrations(path) for path in found])
        for dataset in pool.datasets:
            dataset.preload()
        return pool

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks shown (`simulator/task`), each once."""
        return tuple(dict.fromkeys(dataset.task for dataset in self.datasets))

    @property
    def frames(self) -> int:
        """Frames to train on."""
        return sum(map(len, self._train))

    @cached_property
    def statistics(self) -> TaskStatistics:
        """Of each task, quantiles over its frames to train on."""
        parts = list(zip(self.datasets, self._train, strict=True))
        found = {}
        for task in self.tasks:
            own = [(dataset, frames) for dataset, frames in parts if dataset.task == task]
            found[task] = Statistics.of(
                np.concatenate([dataset.actions[frames] for dataset, frames in own]),
                np.concatenate([dataset.states[frames] for dataset, frames in own]),
            )
        return TaskStatistics(found)

    @cached_property
    def data_hash(self) -> str:
        """Hash of all numbers and pixels."""
        return pooled_hash(self.datasets)

    def sample(self, size: int, *, seed: int, step: int, chunk_length: int, largest_shift: int = 0) -> Batch:
        """A batch from the episodes to train on: datasets drawn uniformly, then frames, with replacement.

        It depends on its arguments alone, so a training that was stopped goes on with the batches it would have had.
        Images are shifted by up to `largest_shift` px, each camera on its own.
        """
        generator = np.random.default_rng([seed, step])
        which = np.sort(generator.integers(len(self.datasets), size=size))
        parts = []
        for index, (dataset, frames) in enumerate(zip(self.datasets, self._train, strict=True)):
            wanted = int((which == index).sum())
            if wanted:
                chosen = frames[generator.integers(len(frames), size=wanted)]
                parts.append(dataset.batch(chosen, chunk_length=chunk_length))
        batch = _joined(parts)
        if largest_shift == 0:
            return batch
        images = {
            camera: shift(batch.images[camera], random_offsets(generator, size, largest_shift), largest_shift)
            for camera in sorted(batch.images)
        }
        return replace(batch, images=images)

    def held_out(self, size: int, *, chunk_length: int, task: str | None = None) -> Iterator[Batch]:
        """Batches of the held-out episodes, always the same, of one task or all; none where there is one episode."""
        for dataset, frames in zip(self.datasets, self._held_out, strict=True):
            if task not in (None, dataset.task):
                continue
            for start in range(0, len(frames), size):
                yield dataset.batch(frames[start : start + size], chunk_length=chunk_length)


def _split(dataset: Demonstrations) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Frames to train on, and held-out ones."""
    episode = np.repeat(np.arange(dataset.episodes), dataset.ends - dataset.starts)
    every = min(HELD_OUT_EVERY, dataset.episodes)
    out = (episode % every == every - 1) & (every > 1)
    held_out = np.flatnonzero(out)
    spread = np.linspace(0, len(held_out) - 1, min(len(held_out), MOST_HELD_OUT)).round().astype(np.int64)
    return np.flatnonzero(~out), held_out[spread]


def _joined(parts: Sequence[Batch]) -> Batch:
    if len(parts) == 1:
        return parts[0]
    return Batch(
        {camera: np.concatenate([part.images[camera] for part in parts]) for camera in parts[0].images},
        np.concatenate([part.states for part in parts]),
        np.concatenate([part.actions for part in parts]),
        np.concatenate([part.mask for part in parts]),
        tuple(instruction for part in parts for instruction in part.instructions),
        tuple(task for part in parts for task in part.tasks),
    )
