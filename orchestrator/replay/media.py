"""Records videos of selected episodes of a run and snapshots of its conditions."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import AdapterError, Simulation
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner, Job
from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.episodes.video_recorder import VideoRecorder, encode_png
from robogauntlet.orchestrator.ray_runtime.session import temporary_folder
from robogauntlet.orchestrator.replay.first_observation import first_observation
from robogauntlet.orchestrator.replay.media_selection import (
    Snapshot,
    first_failures,
    new_failures,
    recording_order,
    representative_episodes,
    shared_by,
)
from robogauntlet.orchestrator.replay.replay import NotReplayed, replay, replay_rows
from robogauntlet.results.media_paths import begun_folder, picture_path, snapshot_path, video_path, videos_folder
from robogauntlet.results.record import EpisodeResult, Status
from robogauntlet.suites.episode import Cell, Condition, Episode
from robogauntlet.support.files import write_whole


@dataclass(frozen=True)
class MediaResult:
    """The recorded files of an episode or a snapshot."""

    files: Mapping[Path, bytes]
    """Path in the run folder to its content."""
    warning: str | None = None
    """A line about what went wrong, if anything."""


def episodes_to_film(work: Iterable[tuple[Cell, Sequence[int]]]) -> frozenset[str]:
    """Ids of one episode of each policy in each simulator, of cells and their seeds, clean if there is such a one.

    It is the second of its cell, or the only one: the first row of a run does not wait for a video.
    """
    chosen: dict[tuple[str, str], str] = {}
    for cell, seeds in sorted(work, key=lambda item: item[0].condition != Condition()):
        if seeds:
            chosen.setdefault((cell.simulator, cell.policy_digest), cell.episode(seeds[min(1, len(seeds) - 1)]).id)
    return frozenset(chosen.values())


def job_of_workers(folder: Path, filmed: Collection[str]) -> Job:
    """What the workers of a run do with their leases: they film episodes while they play them.

    Args:
        folder: The run folder, which they have at hand.
        filmed: Ids of the episodes, filmed at their first attempt. What cannot be filmed is played all the same.
    """
    return partial(_play_lease, folder=folder.absolute(), filmed=filmed) if filmed else EpisodeRunner.play


def end_filming(folder: Path) -> None:
    """Remove unfinished videos."""
    shutil.rmtree(begun_folder(folder), ignore_errors=True)


def _play_lease(
    runner: EpisodeRunner, lease: Lease, *, folder: Path, filmed: Collection[str]
) -> Iterator[EpisodeResult]:
    def play_one(episode: Episode) -> EpisodeResult:
        return _play_filmed(runner, folder, episode) if episode.id in filmed else runner.play_one(episode)

    return runner.play(lease, play_one if lease.attempt == 1 else None)


def _play_filmed(runner: EpisodeRunner, folder: Path, episode: Episode) -> EpisodeResult:
    begun = begun_folder(folder) / f"{episode.id}.mp4"
    with _CarefulRecorder(VideoRecorder(begun, steps=episode.protocol.horizon)) as film:
        result = runner.play_one(episode, film)
    if film.problem is None and begun.exists() and result.status != Status.ERROR:
        with suppress(OSError):
            if result.attempts == 1:
                begun.replace(video_path(folder, episode.id))
            if film.recorder.first is not None and not (picture := picture_path(folder, episode.task)).exists():
                picture.parent.mkdir(parents=True, exist_ok=True)
                write_whole(picture, encode_png(film.recorder.first))
    return result


class _CarefulRecorder:
    """A watcher that stops at its first exception, since no episode may fail for its video."""

    def __init__(self, recorder: VideoRecorder) -> None:
        self.recorder = recorder
        self.problem: Exception | None = None

    def __call__(self, simulation: Simulation, step: int) -> None:
        if self.problem is None:
            try:
                self.recorder(simulation, step)
            except Exception as problem:  # ffmpeg is missing, a full disk, a renderer
                self.problem = problem

    def __enter__(self) -> _CarefulRecorder:
        return self

    def __exit__(self, *error: Any) -> None:
        try:
            self.recorder.__exit__(*error)
        except Exception as problem:
            self.problem = self.problem or problem


def pending_media(
    folder: Path,
    rows: Callable[[], Iterable[EpisodeResult]],
    evaluated: Sequence[str],
    snapshots: Sequence[Snapshot],
    others: Sequence[EpisodeResult] = (),
) -> tuple[list[EpisodeResult], list[Snapshot | EpisodeResult]]:
    """The snapshots and episodes to record that are not in the run folder yet, the most informative first.

    These are the `first_failures`, which a report should not lack, and then all else, from the snapshots on. `rows`
    returns a new iterator over the run's rows at every call. Failures along the axes are recorded of the `evaluated`
    policies only, `others` after them. Of episodes in which policies acted identically, one is recorded.
    """
    files = {path.stem for path in videos_folder(folder).glob("*.mp4")}
    recorded = {shared_by(row) for row in rows() if row.episode_id in files} if files else set()
    groups = (representative_episodes(rows(), files), new_failures(rows, evaluated), others)
    ordered = [row for group in groups for row in recording_order(group)]
    videos = {shared_by(row): row for row in ordered}
    failures = dict.fromkeys(map(shared_by, first_failures(rows(), evaluated, files)))
    return [videos[shared] for shared in failures if shared not in recorded], [
        *(item for item in snapshots if not snapshot_path(folder, item.task, item.condition).exists()),
        *(row for shared, row in videos.items() if shared not in recorded and shared not in failures),
    ]


def record_media(
    folder: Path,
    pending: Sequence[Snapshot | EpisodeResult],
    sources: Mapping[str, PolicySource],
    on_recorded: Callable[[str | None], None],
    environments: EnvironmentResolver,
    time_s: float = math.inf,
) -> None:
    """Record videos and snapshots in one process per simulator, in parallel, for at most `time_s`. Ray must be running.

    Only this process writes into the run folder, because other nodes may not have access to it. `on_recorded` is called
    after every video or snapshot, with a warning if it failed or if the replay of an episode differs from its row.

    Raises:
        RayLost: Ray itself has died. The media recorded before are in the folder.
        OSError: The folder cannot be written.
    """
    # This process owns the temporary files, because one that is killed cannot remove them.
    with tempfile.TemporaryDirectory(dir=temporary_folder(), ignore_cleanup_errors=True) as scratch:
        job = partial(_record, scratch=Path(scratch))
        for _, media in replay_rows(pending, sources, environments, job, time_s):
            if isinstance(media, NotReplayed):
                on_recorded(f"{media.simulator} could not be recorded: {media.reason}")
                continue
            for path, content in media.files.items():
                if not (folder / path).exists():  # each episode of a task yields its picture; the first one is kept
                    (folder / path).parent.mkdir(parents=True, exist_ok=True)
                    write_whole(folder / path, content)
            on_recorded(media.warning)


def _record(item: Snapshot | EpisodeResult, runner: EpisodeRunner, *, scratch: Path) -> MediaResult:
    return _record_snapshot(item, runner) if isinstance(item, Snapshot) else _record_video(item, runner, scratch)


def _record_snapshot(item: Snapshot, runner: EpisodeRunner) -> MediaResult:
    try:
        images = first_observation(runner.simulation(item.task, item.view), item).images
    except AdapterError as error:
        return MediaResult({}, f"no picture: {item.task} under {item.condition}, seed {item.seed}: {error}")
    picture = encode_png(np.concatenate(list(images.values()), axis=1))
    return MediaResult({snapshot_path(Path(), item.task, item.condition): picture})


def _record_video(row: EpisodeResult, runner: EpisodeRunner, scratch: Path) -> MediaResult:
    files, warning = {}, None
    with tempfile.TemporaryDirectory(dir=scratch if scratch.exists() else None) as folder:  # not on other nodes
        video = Path(folder) / "video.mp4"
        with VideoRecorder(video, steps=row.steps or row.horizon) as recorder:
            replayed = replay(row, runner, recorder)
        if replayed.differences:
            warning = f"replay differs: {row.episode_id} ({row.task}, {row.policy}): {replayed.differences[0]}"
        elif video.exists():
            files[video_path(Path(), row.episode_id)] = video.read_bytes()
    if recorder.first is not None:
        files[picture_path(Path(), row.task)] = encode_png(recorder.first)
    return MediaResult(files, warning)
