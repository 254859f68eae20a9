"""Several datasets as one source of batches, with some episodes held out. NumPy in, NumPy out, no torch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from enum import Enum
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import Body
from robogauntlet.policies.training.dataset import Batch, Demonstrations, open_datasets, pooled_hash
from robogauntlet.policies.training.lerobot_format import DatasetError, Floats
from robogauntlet.support.memory import available_memory
from robogauntlet_mergevla.network.normalisation import Statistics, TaskStatistics, padded
from robogauntlet_mergevla.training.augmentation import change_words, shift

HELD_OUT_EVERY = 10
"""The last of every ten episodes is held out."""
MOST_HELD_OUT = 128
"""Largest number of held-out frames per dataset, evenly spread."""

LARGEST_SHARE = 0.8
"""Largest share of the available memory that decoded images may take; the rest is for reading and training."""


class HeldOut(Enum):
    """Which of the held-out episodes: what is chosen on one half is scored on the other."""

    ALL = "all"
    CHOICE = "choice"
    """The first, third, fifth and so on."""
    SCORE = "score"
    """The second, fourth and so on."""


class DatasetMixture:
    """Datasets that are trained on together; each has the same expected share of a batch, whatever its size."""

    def __init__(self, datasets: Sequence[Demonstrations]) -> None:
        """Split each dataset into training and held-out episodes.

        Raises DatasetError without datasets, or if they differ in cameras or image size, or a task in its body.
        """
        if not datasets:
            raise DatasetError("expected at least one dataset, got none")
        self.datasets = tuple(datasets)
        self.cameras, self.image_size = datasets[0].spec.cameras, datasets[0].spec.image_size
        self.action_dim = max(dataset.spec.body.action_dim for dataset in datasets)
        """Numbers of the task that has most; `padded` gives the others' batches as many."""
        self.proprioception_dim = max(dataset.spec.body.proprioception_dim for dataset in datasets)
        bodies: dict[str, Body] = {}
        for dataset in datasets:
            if dataset.spec.body.native:
                raise DatasetError(f"{dataset.folder}: expected actions of a robot, got {dataset.spec.body.moves}")
            if (expected := bodies.setdefault(dataset.task, dataset.spec.body)) != dataset.spec.body:
                raise DatasetError(
                    f"{dataset.folder}: expected actions of {', '.join(expected.action_names)}, as in another dataset "
                    f"of {dataset.task}, got {', '.join(dataset.spec.body.action_names)}"
                )
            if (set(dataset.spec.cameras), dataset.spec.image_size) != (set(self.cameras), self.image_size):
                raise DatasetError(
                    f"{dataset.folder}: expected {self.image_size} px images of {', '.join(self.cameras)} as in "
                    f"{datasets[0].folder}, got {dataset.spec.image_size} px of {', '.join(dataset.spec.cameras)}"
                )
        split = [_split(dataset) for dataset in datasets]
        self._train = [frames for frames, _ in split]
        self._held_out = [frames for _, frames in split]

    @classmethod
    def open(cls, folders: Sequence[Path]) -> DatasetMixture:
        """Open the datasets in these folders (datasets or folders of them), with decoded images in memory.

        Raises DatasetError if a dataset starts as an evaluation would: it has a seed that suites play; and if there is
        not enough memory.
        """
        mixture = cls(open_datasets(folders))
        needed = sum(dataset.image_bytes for dataset in mixture.datasets)
        most = LARGEST_SHARE * available_memory()
        if needed > most:
            raise DatasetError(
                f"expected at most {most / 1e9:.1f} GB of decoded images, {LARGEST_SHARE:.0%} of the available memory, "
                f"got {needed / 1e9:.1f} GB; train on fewer datasets, or on shorter ones"
            )
        for dataset in mixture.datasets:
            dataset.preload()
        return mixture

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of the datasets (`simulator/task`), each once."""
        return tuple(dict.fromkeys(dataset.task for dataset in self.datasets))

    @property
    def frames(self) -> int:
        """Number of frames to train on."""
        return sum(map(len, self._train))

    @cached_property
    def statistics(self) -> TaskStatistics:
        """Normalisation statistics of each task over its training frames."""
        parts = list(zip(self.datasets, self._train, strict=True))
        by_task = {}
        for task in self.tasks:
            of_task = [(dataset, frames) for dataset, frames in parts if dataset.task == task]
            by_task[task] = Statistics.of(
                np.concatenate([dataset.actions[frames] for dataset, frames in of_task]),
                np.concatenate([dataset.states[frames] for dataset, frames in of_task]),
            )
        return TaskStatistics(by_task)

    @cached_property
    def data_hash(self) -> str:
        """Hash of all numbers and pixels."""
        return pooled_hash(self.datasets)

    def sample(
        self,
        size: int,
        *,
        seed: int,
        step: int,
        chunk_length: int,
        largest_shift: int = 0,
        changed_words: float = 0.0,
    ) -> Batch:
        """Draw a training batch with replacement: datasets uniformly, then their frames.

        The batch depends on the arguments alone, so a resumed training sees the same batches. Images are shifted by up
        to `largest_shift` px, each camera on its own, and this share of the words is changed, see `augmentation`.
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
        if largest_shift:
            images = {
                camera: shift(
                    batch.images[camera],
                    generator.integers(-largest_shift, largest_shift + 1, (size, 2)),
                    largest_shift,
                )
                for camera in sorted(batch.images)
            }
            batch = replace(batch, images=images)
        if changed_words:
            batch = replace(batch, instructions=change_words(batch.instructions, generator, changed_words))
        return batch

    def held_out(
        self, size: int, *, chunk_length: int, task: str | None = None, part: HeldOut = HeldOut.ALL
    ) -> Iterator[Batch]:
        """Yield fixed batches of the held-out episodes of one task or all; a dataset of one episode has none."""
        for dataset, all_frames in zip(self.datasets, self._held_out, strict=True):
            if task not in (None, dataset.task):
                continue
            frames = all_frames
            if part is not HeldOut.ALL:
                _, number = np.unique(_episode_of(dataset)[all_frames], return_inverse=True)
                frames = all_frames[number % 2 == (part is HeldOut.SCORE)]
            for start in range(0, len(frames), size):
                yield dataset.batch(frames[start : start + size], chunk_length=chunk_length)


def _episode_of(dataset: Demonstrations) -> NDArray[np.int64]:
    """Return the number of each frame's episode."""
    return np.repeat(np.arange(dataset.episodes), dataset.ends - dataset.starts)


def _split(dataset: Demonstrations) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the training frames and the held-out frames."""
    episode = _episode_of(dataset)
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
        _stacked([part.states for part in parts]),
        _stacked([part.actions for part in parts]),
        np.concatenate([part.mask for part in parts]),
        tuple(instruction for part in parts for instruction in part.instructions),
        tuple(task for part in parts for task in part.tasks),
    )


def _stacked(parts: Sequence[Floats]) -> Floats:
    """Concatenate numbers of tasks, with zeros for those that a task does not have."""
    widest = max(part.shape[-1] for part in parts)
    return np.concatenate([padded(part, widest) for part in parts])
