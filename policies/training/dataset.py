"""Reads demonstrations for training: NumPy in, NumPy out, no torch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from robogauntlet.adapters.contract import GRIPPER, Moves
from robogauntlet.policies.training.lerobot_format import (
    ACTION,
    CODEBASE_VERSION,
    EPISODES_FILE,
    INFO_FILE,
    JOURNAL_FILE,
    STATE,
    SUCCESS,
    TASKS_FILE,
    DatasetError,
    DatasetSpec,
    Floats,
    decode_png,
    episode_hash,
    image_key,
    numbers,
    spec_of,
)
from robogauntlet.suites.episode import FIRST_TRAINING_SEED, content_hash
from robogauntlet.support.errors import first_line
from robogauntlet.support.files import open_regular, read_regular
from robogauntlet.support.json_text import parse_json

CHUNK_LENGTH = 8
UNREADABLE = (OSError, UnicodeDecodeError, pa.ArrowException)
"""What Arrow raises for files that it cannot read; the second for names of columns."""


@dataclass(frozen=True)
class Batch:
    """Training data: b frames of any episodes."""

    images: Mapping[str, NDArray[np.uint8]]
    """Camera name to images (b, size, size, 3)."""
    states: Floats
    """Proprioception, shape (b, numbers)."""
    actions: Floats
    """Actions from this step on, shape (b, chunk, numbers).

    Past the episode's end: no motion, the last command of grippers and targets."""
    mask: NDArray[np.bool_]
    """False past the episode's end, shape (b, chunk)."""
    instructions: tuple[str, ...]
    tasks: tuple[str, ...]
    """Task of each frame (`simulator/task`), which decides the normalisation."""


class Demonstrations:
    """An open dataset. Numbers are in memory; images are read at first use and decoded on demand."""

    def __init__(self, folder: Path) -> None:
        """Open a LeRobot v3 dataset with our state, action and image columns. Raises DatasetError for another."""
        self.folder = folder
        info, self.spec = _read_info(folder)
        self._files = sorted((folder / "data").glob("*/*.parquet"))
        table = self._read([STATE, ACTION, SUCCESS, "episode_index", "index", "task_index"])
        self.states: Floats = self._column(table, STATE, self.spec.body.proprioception_dim).astype(np.float32)
        self.actions: Floats = self._column(table, ACTION, self.spec.body.action_dim).astype(np.float32)
        self.success: NDArray[np.bool_] = self._column(table, SUCCESS, 1)[:, 0].astype(np.bool_)
        episode = self._column(table, "episode_index", 1)[:, 0]
        index = self._column(table, "index", 1)[:, 0]
        if len(index) != info["total_frames"] or not np.array_equal(index, np.arange(len(index))):
            is_ours = (folder / JOURNAL_FILE).is_file()
            hint = "; if it was being collected, give the same command to continue" if is_ours else ""
            raise DatasetError(
                f"{folder}: expected frames 0 to {info['total_frames'] - 1} in order, got {len(index)}{hint}"
            )
        if not len(index):
            raise DatasetError(f"{folder}: expected at least one episode, got none")
        self.starts = np.flatnonzero(np.diff(episode, prepend=-1))
        """First frame of each episode."""
        self.ends = np.append(self.starts[1:], len(episode))
        """First frame past each episode."""
        self._end_of_frame = np.repeat(self.ends, self.ends - self.starts)
        if len(self.starts) != info["total_episodes"]:
            raise DatasetError(f"{folder}: expected {info['total_episodes']} episodes, got {len(self.starts)}")
        self._task_index = self._column(table, "task_index", 1)[:, 0]
        self._tasks = _read_tasks(folder)
        if not set(self._task_index.tolist()) <= set(self._tasks):
            raise DatasetError(f"{folder}: {TASKS_FILE} does not name every task_index of the data")
        self._decoded: dict[str, NDArray[np.uint8]] = {}

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.actions)

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.starts)

    @cached_property
    def task(self) -> str:
        """The dataset's task, from RoboGauntlet's own metadata or the folder's name."""
        return str(self._source.get("task", self.folder.name))

    @cached_property
    def seeds(self) -> tuple[int, ...]:
        """The seed of each episode; empty for a dataset of another origin."""
        try:
            metadata = pq.read_table(_regular(self.folder / EPISODES_FILE))
            return tuple(metadata["seed"].to_pylist()) if "seed" in metadata.column_names else ()
        except UNREADABLE as error:
            raise DatasetError(f"{self.folder}: {EPISODES_FILE} cannot be read: {first_line(error)}") from None

    @property
    def starts_midway(self) -> bool:
        """Whether its episodes begin where the oracle took over from a learner, not at the task's start."""
        return "learner" in self._source and not self._source.get("whole")

    @property
    def is_replayable(self) -> bool:
        """Whether its actions are all that was executed, as far as is known: without noise and without a learner."""
        return not self._source.get("noise") and "learner" not in self._source

    @cached_property
    def _source(self) -> dict[str, Any]:
        """How RoboGauntlet recorded the dataset; empty for a dataset of another origin."""
        path = self.folder / JOURNAL_FILE
        try:
            return dict(parse_json(read_regular(path))["source"])
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DatasetError(f"{path}: cannot be read: {type(error).__name__}: {error}") from None

    @property
    def instructions(self) -> tuple[str, ...]:
        """Every instruction, in order of first appearance."""
        return tuple(self._tasks[number] for number in sorted(self._tasks))

    def images(self, camera: str, frames: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return images of a camera, shape (b, size, size, 3). DatasetError without it, or for a broken image."""
        if camera in self._decoded:
            return self._decoded[camera][frames]
        if camera not in self.spec.cameras:
            raise DatasetError(f"{self.folder}: expected camera {', '.join(self.spec.cameras)}, got {camera}")
        encoded, images = self._png.column(image_key(camera)), self._empty(len(frames))
        self._decode(camera, (encoded[int(frame)] for frame in frames), images)
        return images

    @property
    def image_bytes(self) -> int:
        """Memory for its decoded images (bytes)."""
        return len(self) * len(self.spec.cameras) * self.spec.image_size**2 * 3

    def preload(self) -> None:
        """Decode all images now, one data file after another.

        Needs 28 KB per frame and camera at 96 px, and saves several hundred microseconds each.
        """
        if self._decoded:
            return
        self.__dict__.pop("_png", None)
        decoded = {camera: self._empty(len(self)) for camera in self.spec.cameras}
        begin = 0
        for part in self._tables([image_key(camera) for camera in self.spec.cameras]):
            end = begin + len(part)
            for camera, images in decoded.items():
                self._decode(camera, part.column(image_key(camera)), images[begin:end])
            begin = end
        self._decoded = decoded

    def batch(self, frames: NDArray[np.int64], *, chunk_length: int = CHUNK_LENGTH) -> Batch:
        """Return these frames, each with the actions from there on."""
        ends = self._end_of_frame[frames]
        steps = np.asarray(frames)[:, None] + np.arange(chunk_length)
        mask = steps < ends[:, None]
        actions = self.actions[np.minimum(steps, ends[:, None] - 1)]
        if self.spec.body.moves is not Moves.TARGETS:
            moves = [not name.endswith(GRIPPER) for name in self.spec.body.action_names]
            actions[..., moves] *= mask[..., None]
        return Batch(
            {camera: self.images(camera, frames) for camera in self.spec.cameras},
            self.states[frames],
            actions,
            mask,
            tuple(self._tasks[int(number)] for number in self._task_index[frames]),
            (self.task,) * len(frames),
        )

    @cached_property
    def episode_hashes(self) -> tuple[str, ...]:
        """Hash of each episode (`episode_hash`), computed from the data: decodes every image."""
        return tuple(map(self._hash, range(self.episodes)))

    @property
    def content_hash(self) -> str:
        """Hash of the numbers and pixels, independent of the order of the episodes and their files."""
        return pooled_hash([self])

    def _hash(self, episode: int) -> str:
        frames = np.arange(self.starts[episode], self.ends[episode])
        return episode_hash(
            self._tasks[int(self._task_index[frames[0]])],
            self.spec.fps,
            self.states[frames],
            self.actions[frames],
            self.success[frames],
            {camera: self.images(camera, frames) for camera in self.spec.cameras},
        )

    @cached_property
    def _png(self) -> pa.Table:
        return self._read([image_key(camera) for camera in self.spec.cameras])

    def _empty(self, images: int) -> NDArray[np.uint8]:
        return np.empty((images, self.spec.image_size, self.spec.image_size, 3), np.uint8)

    def _decode(self, camera: str, encoded: Iterable[pa.Scalar], images: NDArray[np.uint8]) -> None:
        for place, scalar in zip(images, encoded, strict=True):
            row = scalar.as_py()
            png = row["bytes"] if row is not None else None
            if png is None:
                raise DatasetError(f"{self.folder}: {camera}: expected images within the data files, got none")
            try:
                image = decode_png(png)
            except DatasetError as error:
                raise DatasetError(f"{self.folder}: {camera}: {error}") from None
            if image.shape != place.shape:
                raise DatasetError(f"{self.folder}: {camera}: expected images {place.shape}, got {image.shape}")
            place[:] = image

    def _read(self, columns: Sequence[str]) -> pa.Table:
        return pa.concat_tables(self._tables(columns), promote_options="default")

    def _tables(self, columns: Sequence[str]) -> Iterator[pa.Table]:
        """Yield these columns of one data file after another."""
        if not self._files:
            raise DatasetError(f"{self.folder}: expected data/chunk-000/file-000.parquet, got no data file")
        first: pa.Schema | None = None
        for path in self._files:
            try:
                file = pq.ParquetFile(_regular(path))
                missing = [name for name in columns if name not in file.schema_arrow.names]
                if missing:
                    raise DatasetError(f"{path}: expected a column {missing[0]}, got none")
                part = file.read(list(columns))
            except UNREADABLE as error:
                raise DatasetError(f"{path}: cannot be read: {first_line(error)}") from None
            first = first or part.schema
            for name in columns:
                if part.schema.field(name).type != first.field(name).type:
                    kinds = f"{first.field(name).type}, got {part.schema.field(name).type}"
                    raise DatasetError(f"{path}: expected {name} as in {self._files[0].name}, {kinds}")
            yield part

    def _column(self, table: pa.Table, name: str, width: int) -> NDArray[Any]:
        try:
            values = numbers(table, name)
        except ValueError:  # raised by Arrow for a missing value in a list
            values = np.array([[None]])
        if table.column(name).null_count or values.dtype.kind not in "biuf":
            raise DatasetError(f"{self.folder}: {name}: expected numbers in each frame, got something else")
        if values.shape[1] != width:
            raise DatasetError(f"{self.folder}: {name}: expected {width} numbers per frame, got {values.shape[1]}")
        if not np.isfinite(values).all():
            raise DatasetError(f"{self.folder}: {name}: expected finite numbers, got NaN or infinity")
        return values


def pooled_hash(datasets: Sequence[Demonstrations]) -> str:
    """Return the hash of the content of several datasets, in any order."""
    return content_hash(sorted(value for dataset in datasets for value in dataset.episode_hashes))


def find_datasets(folders: Sequence[Path]) -> list[Path]:
    """Return the datasets among these folders and in them, each once and sorted.

    Raises DatasetError if there is no dataset for one of them, or it cannot be read.
    """
    datasets: dict[Path, Path] = {}
    for folder in folders:
        try:
            # A glob would silently skip unreadable folders.
            is_dataset = (folder / INFO_FILE).is_file()
            places = [folder] if is_dataset else sorted(folder.iterdir()) if folder.is_dir() else []
            found = {place.resolve(): place for place in places if (place / INFO_FILE).is_file()}
        except OSError as error:
            raise DatasetError(f"{error.filename or folder}: cannot be read: {error.strerror}") from None
        if not found:
            raise DatasetError(f"{folder}: expected a dataset ({INFO_FILE}) or a folder of them, got none")
        datasets |= found
    return sorted(datasets.values())


def open_datasets(folders: Sequence[Path]) -> list[Demonstrations]:
    """Open the datasets in these folders (datasets or folders of them).

    Raises DatasetError as `find_datasets` does, and for a dataset with a seed that suites play.
    """
    datasets = [Demonstrations(path) for path in find_datasets(folders)]
    for dataset in datasets:
        if evaluated := sorted(seed for seed in dataset.seeds if seed < FIRST_TRAINING_SEED):
            raise DatasetError(
                f"{dataset.folder}: expected seeds from {FIRST_TRAINING_SEED} on, which are for training, "
                f"got {evaluated[0]}: a policy that is trained on it would be evaluated on what it has seen"
            )
    return datasets


def datasets_of(folders: Sequence[Path], tasks: Sequence[str]) -> list[Demonstrations]:
    """Open the datasets of these tasks among all in these folders.

    Raises DatasetError for a folder without datasets, or if a task has none.
    """
    datasets = [dataset for dataset in map(Demonstrations, find_datasets(folders)) if dataset.task in tasks]
    missing = [task for task in tasks if task not in {dataset.task for dataset in datasets}]
    if folders and missing:
        raise DatasetError(f"expected demonstrations of each expert's task, got none of {missing[0]}")
    return datasets


def _read_info(folder: Path) -> tuple[dict[str, Any], DatasetSpec]:
    path = folder / INFO_FILE
    try:
        info = parse_json(read_regular(path))
        version = info["codebase_version"]
        total_frames, total_episodes = int(info["total_frames"]), int(info["total_episodes"])
        images = [name for name in info["features"] if name.startswith(image_key(""))]
        spec = spec_of(info) if images and version == CODEBASE_VERSION else None
    except OSError as error:
        raise DatasetError(f"{path}: expected a LeRobot dataset: {error.strerror}") from None
    except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: expected a LeRobot dataset: {type(error).__name__}: {error}") from None
    if version != CODEBASE_VERSION:
        raise DatasetError(f"{path}: expected codebase_version {CODEBASE_VERSION}, got {version}")
    if spec is None:
        raise DatasetError(f"{path}: expected an image column {image_key('CAMERA')}, got none")
    return {"total_frames": total_frames, "total_episodes": total_episodes}, spec


def _read_tasks(folder: Path) -> dict[int, str]:
    import pandas as pd

    try:
        tasks = pd.read_parquet(_regular(folder / TASKS_FILE))
        return {int(number): str(task) for task, number in tasks["task_index"].items()}
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise DatasetError(f"{folder / TASKS_FILE}: cannot be read: {first_line(error)}") from None


def _regular(path: Path) -> Path:
    """The path of a file that Arrow may open, which would wait for a named pipe. Raises OSError for another."""
    open_regular(path).close()
    return path
