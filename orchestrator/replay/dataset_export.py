"""Replays chosen episodes of a run and writes them as LeRobot datasets, one per task.

An episode is determined by its identity, so a run stores no frames; they are rendered again on request. An episode
whose outcome differs from its row is omitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robogauntlet.adapters.contract import Simulation
from robogauntlet.orchestrator.demonstrations.collect import RecordingResult, dataset_name, recording
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.episodes.trajectory_recorder import TrajectoryRecorder
from robogauntlet.orchestrator.ray_runtime.session import ray_session
from robogauntlet.orchestrator.replay.episode_filter import condition_of
from robogauntlet.orchestrator.replay.replay import NotReplayed, replay, replay_rows
from robogauntlet.policies.training.dataset_writer import Attempt, DatasetWriter
from robogauntlet.policies.training.lerobot_format import DatasetError, EncodedEpisode, encode_episode
from robogauntlet.results.folder_lock import lock_folder
from robogauntlet.results.record import EpisodeResult, Status
from robogauntlet.results.run_document import RunDocument

PLAYED = (str(Status.FAILURE), str(Status.SUCCESS))
"""Statuses of episodes that can be replayed."""
DESCRIBED = ("episode_id", "pair_id", "policy", "policy_digest", "axis", "severity", "status", "success_once")
"""Fields of the row that are stored with each episode, under `meta/episodes`."""


def record_episode(row: EpisodeResult, runner: EpisodeRunner) -> EncodedEpisode | str:
    """Replay a row's episode and record it. Simulator errors are not raised.

    Returns:
        The episode, or a line with the reason if there is none.
    """
    recorders: list[TrajectoryRecorder] = []

    def record(simulation: Simulation) -> Simulation:
        recorders.append(TrajectoryRecorder(simulation))
        return recorders[-1]

    replayed = replay(row, runner, lambda simulation, step: recorders[-1].watch(simulation, step), record)
    name = f"{row.episode_id} ({row.task}, {row.policy}, {condition_of(row)}, seed {row.seed})"
    if replayed.result.status == Status.ERROR:
        return f"{name}: could not be played again: {replayed.result.error}"
    if replayed.differences:
        return f"{name}: the outcome differs and the episode is left out: {replayed.differences[0]}"
    about = {field: getattr(row, field) for field in DESCRIBED}
    try:
        return encode_episode(recorders[-1].recording(about))
    except DatasetError as error:
        return f"{name}: {error}"


@dataclass
class DatasetExport(RecordingResult):
    """The datasets of a run's episodes."""

    writers: dict[str, DatasetWriter] = field(default_factory=dict)
    """Task to its dataset."""
    wanted: int = 0
    existing: int = 0
    """Number of wanted episodes that were in the datasets before."""


def write_datasets(
    rows: Sequence[EpisodeResult],
    document: RunDocument,
    sources: Mapping[str, PolicySource],
    folder: Path,
    on_start: Callable[[DatasetExport, int], Callable[[], None]],
    environments: EnvironmentResolver,
) -> DatasetExport:
    """Replay rows in one process per simulator and write their episodes, continuing existing datasets.

    Args:
        rows: Rows of the run without errors, grouped by task.
        document: The run.
        sources: Its policies.
        folder: The folder of the datasets, one per task.
        on_start: Called with the export and the number of episodes to replay; returns a function to call after each.
        environments: The environment of each simulator.

    Raises:
        DatasetError: The folder contains other data.
        FolderError: Another process writes into the folder, or it cannot be written.
    """
    export = DatasetExport(wanted=len(rows))
    with lock_folder(folder):
        for row in rows:
            if row.task not in export.writers:
                source = {"task": row.task, "run_id": document.run_id, "protocol": row.episode.protocol.described()}
                export.writers[row.task] = DatasetWriter(folder / dataset_name(row.task), source, keeps=PLAYED)
        existing = {name for writer in export.writers.values() for name in writer.about("episode_id")}
        missing = [row for row in rows if row.episode_id not in existing]
        export.existing = len(rows) - len(missing)
        if missing:
            on_replayed = on_start(export, len(missing))
            simulators = {row.simulator for row in missing}
            with recording(export, export.writers.values()), ray_session(address=None, workers=len(simulators)):
                _add_episodes(export, replay_rows(missing, sources, environments, record_episode), on_replayed)
    return export


def _add_episodes(
    export: DatasetExport,
    episodes: Iterable[tuple[EpisodeResult, EncodedEpisode | str | NotReplayed]],
    on_replayed: Callable[[], None],
) -> None:
    not_replayed: Counter[NotReplayed] = Counter()
    try:
        for row, episode in episodes:
            if isinstance(episode, NotReplayed):
                not_replayed[episode] += 1
            elif isinstance(episode, str):
                export.warnings.append(episode)
            else:
                writer = export.writers[row.task]
                writer.add(Attempt(row.seed, row.status, row.steps), episode)
                writer.flush_if_due()
            on_replayed()
    finally:
        for why, count in not_replayed.items():
            export.warnings.append(f"{why.simulator}: {count} not played again: {why.reason}")
