"""Writes a LeRobot dataset in steps, so that a collection can be stopped at any time and continued later."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from robogauntlet.policies.training.lerobot_format import (
    CODEBASE_VERSION,
    DATA_FILE,
    EPISODES_FILE,
    FILES_PER_CHUNK,
    INFO_FILE,
    JOURNAL_FILE,
    NATIVE,
    ROBOT,
    STATS_FILE,
    TASKS_FILE,
    DatasetError,
    DatasetSpec,
    EncodedEpisode,
    episode_table,
    features,
    image_key,
    number_statistics,
    numbers,
    pooled_image_statistics,
    spec_of,
)
from robogauntlet.suites.episode import content_hash
from robogauntlet.support.files import read_regular, replacing
from robogauntlet.support.interrupts import deferred_interrupts
from robogauntlet.support.json_text import parse_json

SUCCESS_STATUS = "success"
FLUSH_BYTES = 32 * 2**20
"""Size of pending episodes above which they are committed."""
FLUSH_S = 10.0
"""Time since the last commit after which pending episodes are committed."""
STORAGE: Mapping[str, Any] = {"compression": "none", "use_dictionary": False, "write_statistics": ["episode_index"]}
"""PNG cannot be compressed further and no two images are equal, so no compression or dictionary is used."""


@dataclass(frozen=True)
class Attempt:
    """One played seed. Its episode is stored if it succeeded, otherwise only counted."""

    seed: int
    status: str
    """`success`, `failure` or `error`."""
    steps: int
    error: str | None = None


class DatasetWriter:
    """Writes one dataset into one folder. Committed episodes survive the process, pending ones are lost with it.

    A commit rewrites the metadata of the whole dataset, so several pending episodes share one. `meta/robogauntlet.json`
    is written last and lists what is committed; any other files were left by a killed process and are overwritten.
    """

    def __init__(self, folder: Path, source: Mapping[str, Any], *, now: Callable[[], float] = time.monotonic) -> None:
        """Create or continue a dataset.

        Args:
            folder: Folder of the dataset, created at the first commit. DatasetError if it holds something else.
            source: How the episodes are produced, as plain JSON. Must be the same to continue.
            now: Returns a time in s, with any origin.
        """
        self.folder = folder
        self.source = json.loads(json.dumps(source))
        self.attempts: list[Attempt] = []
        self.spec: DatasetSpec | None = None
        self._rows: list[dict[str, Any]] = []
        self._numbers: list[pa.Table] = []
        self._tasks: dict[str, int] = {}
        self._files = 0
        self._now = now
        self._added: list[tuple[Attempt, EncodedEpisode | None]] = []
        self._committed_at = now()
        if (folder / JOURNAL_FILE).exists():
            self._continue()
        elif (folder / "meta").exists():
            raise DatasetError(f"{folder}: expected an empty folder or a dataset of ours, {JOURNAL_FILE} is missing")

    @property
    def episodes(self) -> int:
        """Number of committed episodes."""
        return len(self._rows)

    @property
    def frames(self) -> int:
        """Number of committed frames."""
        return int(self._rows[-1]["dataset_to_index"]) if self._rows else 0

    @property
    def content_hash(self) -> str | None:
        """Same as `Demonstrations.content_hash`, from the hashes of the recorded episodes; None without episodes."""
        return content_hash(sorted(row["content_hash"] for row in self._rows)) if self._rows else None

    def add(self, attempt: Attempt, episode: EncodedEpisode | None) -> None:
        """Add a played seed, with its episode if that is kept, to the pending ones."""
        self._added.append((attempt, episode))

    def flush_if_due(self) -> None:
        """Commit the pending episodes if they are large or the last commit was long ago. Raises as `commit`."""
        size = sum(episode.size for _, episode in self._added if episode is not None)
        if size > FLUSH_BYTES or self._now() - self._committed_at > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Commit the pending episodes; they are dropped if that fails. Raises as `commit`.

        A Ctrl-C waits until they are committed.
        """
        if not self._added:
            return
        with deferred_interrupts():
            added, self._added = self._added, []
            self.commit([attempt for attempt, _ in added], [episode for _, episode in added if episode is not None])
            self._committed_at = self._now()

    def commit(self, attempts: Sequence[Attempt], episodes: Sequence[EncodedEpisode]) -> None:
        """Write played seeds and the episodes that are kept of them, in order.

        Raises:
            DatasetError: The two do not match, or the episodes do not fit those already in the dataset.
            OSError: A file cannot be written; nothing is committed.
        """
        expected = [attempt.seed for attempt in attempts if attempt.status == SUCCESS_STATUS]
        if expected != [episode.seed for episode in episodes]:
            raise DatasetError(f"expected episodes of the kept seeds {expected}, got {[e.seed for e in episodes]}")
        for episode in episodes:
            self.spec = self.spec or episode.spec
            if episode.spec != self.spec:
                raise DatasetError(f"{self.folder}: expected episodes of {self.spec}, got {episode.spec}")
        if not (self.folder / JOURNAL_FILE).exists():
            self._write_journal()  # so that leftovers of a first commit are recognised
        if episodes:
            self._add(episodes)
        self.attempts += attempts
        self._write_journal()

    def _write_journal(self) -> None:
        document = {
            "source": self.source,
            "data_files": self._files,
            "episodes": self.episodes,
            "attempts": [asdict(attempt) for attempt in self.attempts],
        }
        _write_json(self.folder / JOURNAL_FILE, document)

    def _add(self, episodes: Sequence[EncodedEpisode]) -> None:
        chunk, file = divmod(self._files, FILES_PER_CHUNK)
        tables = []
        for episode in episodes:
            first = self.frames
            task_index = self._tasks.setdefault(episode.instruction, len(self._tasks))
            table = episode_table(episode, episode_index=len(self._rows), first_index=first, task_index=task_index)
            tables.append(table)
            self._numbers.append(_without_images(table))
            self._rows.append(_row(episode, table, len(self._rows), first, chunk, file))
        path = self.folder / DATA_FILE.format(chunk_index=chunk, file_index=file)
        with _replacing(path) as partial, pq.ParquetWriter(partial, tables[0].schema, **STORAGE) as writer:
            for table in tables:
                writer.write_table(table)  # a row group per episode
        self._files += 1
        self._describe()

    def _describe(self) -> None:
        """Write all metadata files except the journal."""
        import pandas as pd

        assert self.spec is not None
        with _replacing(self.folder / EPISODES_FILE) as partial:
            pq.write_table(pa.Table.from_pylist(self._rows), partial)
        tasks = pd.DataFrame({"task_index": list(self._tasks.values())}, index=pd.Index(self._tasks, name="task"))
        with _replacing(self.folder / TASKS_FILE) as partial:
            tasks.to_parquet(partial)
        _write_json(self.folder / STATS_FILE, self._statistics())
        robot = self.source["task"].partition("/")[0] if self.spec.body.joints else ROBOT
        info = {
            "codebase_version": CODEBASE_VERSION,
            "robot_type": NATIVE if self.spec.body.native else robot,
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self.spec.fps,
            "splits": {"train": f"0:{self.episodes}"},
            "data_path": DATA_FILE,
            "video_path": None,
            "features": features(self.spec),
        }
        _write_json(self.folder / INFO_FILE, info)

    def _statistics(self) -> dict[str, Any]:
        assert self.spec is not None
        table = pa.concat_tables(self._numbers)
        statistics = {name: number_statistics(numbers(table, name)) for name in table.column_names}
        for camera in self.spec.cameras:
            key = image_key(camera)
            names = ("min", "max", "mean", "std", "count")
            parts = [{name: row[f"stats/{key}/{name}"] for name in names} for row in self._rows]
            statistics[key] = pooled_image_statistics(parts)
        return statistics

    def _continue(self) -> None:
        path = self.folder / JOURNAL_FILE
        try:
            document = parse_json(read_regular(path))
            stored = dict(document["source"])
            self._files, episodes = int(document["data_files"]), int(document["episodes"])
            self.attempts = [Attempt(**attempt) for attempt in document["attempts"]]
        except (OSError, OverflowError, ValueError, KeyError, TypeError) as error:
            raise DatasetError(f"{path}: expected a record of attempts: {type(error).__name__}: {error}") from None
        for key in {**stored, **self.source}:
            before, now = stored.get(key), self.source.get(key)
            if before != now:
                what = f"{key} {json.dumps(before)}, now {json.dumps(now)}"
                raise DatasetError(f"{self.folder}: it was begun with {what}; choose another --out")
        if not episodes:
            return
        try:
            self._rows = pq.read_table(self.folder / EPISODES_FILE).to_pylist()[:episodes]
            for number in range(self._files):
                chunk, file = divmod(number, FILES_PER_CHUNK)
                data = pq.ParquetFile(self.folder / DATA_FILE.format(chunk_index=chunk, file_index=file))
                names = [field.name for field in data.schema_arrow if not pa.types.is_struct(field.type)]
                self._numbers.append(data.read(names))
            self.spec = spec_of(parse_json(read_regular(self.folder / INFO_FILE)))
        except (OSError, OverflowError, ValueError, KeyError, TypeError, pa.ArrowException) as error:
            raise DatasetError(f"{self.folder}: it cannot be continued: {type(error).__name__}: {error}") from None
        for row in self._rows:
            self._tasks.setdefault(row["tasks"][0], len(self._tasks))


def _row(
    episode: EncodedEpisode, table: pa.Table, episode_index: int, first_index: int, chunk: int, file: int
) -> dict[str, Any]:
    """Return an episode's row under `meta/episodes`. LeRobot's format has no `seed` and `content_hash`."""
    plain = _without_images(table)
    statistics = {name: number_statistics(numbers(plain, name)) for name in plain.column_names}
    statistics |= {image_key(camera): dict(values) for camera, values in episode.image_statistics.items()}
    return {
        "episode_index": episode_index,
        "tasks": [episode.instruction],
        "length": len(episode),
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": first_index,
        "dataset_to_index": first_index + len(episode),
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        "seed": episode.seed,
        "content_hash": episode.content_hash,
        **{f"stats/{key}/{name}": value for key, values in statistics.items() for name, value in values.items()},
    }


def _without_images(table: pa.Table) -> pa.Table:
    return table.select([field.name for field in table.schema if not pa.types.is_struct(field.type)])


def _replacing(path: Path) -> AbstractContextManager[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    return replacing(path)


def _write_json(path: Path, content: object) -> None:
    with _replacing(path) as partial:
        partial.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
