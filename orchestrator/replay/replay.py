"""Replays stored episodes, and compares the outcomes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulation
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.episodes.rollout import Watcher
from robogauntlet.orchestrator.episodes.video_recorder import VideoRecorder
from robogauntlet.orchestrator.replay.media_selection import Snapshot
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.contract import PolicyError
from robogauntlet.results.record import OUTCOME, EpisodeResult
from robogauntlet.results.run_document import RunDocument
from robogauntlet.suites.loading import SuiteError
from robogauntlet.suites.schema import Suite
from robogauntlet.support.errors import BadInput


class ReplayError(BadInput):
    """An episode that cannot be replayed; the message says why."""


Row = TypeVar("Row", bound=EpisodeResult | Snapshot)
Job = Callable[[Row, EpisodeRunner], Any]
"""Processes a row. Importable on every node."""


@dataclass(frozen=True)
class Replayed:
    """The outcome of a replay."""

    result: EpisodeResult
    differences: tuple[str, ...]
    """A line for each outcome field that differs from the stored row."""


@dataclass(frozen=True)
class NotReplayed:
    """The reason why a row was not replayed: its simulator's process could not be started, or died."""

    simulator: str
    reason: str


def policy_sources(document: RunDocument, suite: Suite) -> dict[str, PolicySource]:
    """The policies of a run by name, from the suite that plays it.

    Raises:
        ReplayError: The suite lacks a policy of the run, it has changed since the run, or it cannot be used.
    """
    digests = {cell.policy: cell.policy_digest for cell in document.plan}
    if lacking := sorted(digests.keys() - {entry.name for entry in suite.policies}):
        raise ReplayError(f"suite '{suite.name}' lacks the run's policy '{lacking[0]}'; name the suite that was played")
    sources, environments = {}, environments_of(suite)
    for entry in suite.policies:
        if entry.name not in digests:
            continue
        try:
            options = environments.options(entry.kind, entry.options)
        except PolicyError as error:
            raise ReplayError(f"policy '{entry.name}': {error.reason}") from None
        if policies.digest(entry.kind, options) != digests.get(entry.name):
            raise ReplayError(f"policy '{entry.name}' has changed since the run; check out the commit of the run")
        sources[entry.name] = PolicySource(entry.kind, options)
    return sources


def environments_of(suite: Suite) -> EnvironmentResolver:
    """The environments of simulators and policies, by a suite and the user's configuration.

    Raises:
        ReplayError: The configuration cannot be read.
    """
    try:
        return EnvironmentResolver(suite.environments)
    except SuiteError as error:
        raise ReplayError(f"the run's environments cannot be read: {error}") from None


def replay(
    row: EpisodeResult,
    runner: EpisodeRunner,
    watcher: Watcher | None = None,
    wrap: Callable[[Simulation], Simulation] | None = None,
) -> Replayed:
    """Replay a row's episode; for the arguments see `EpisodeRunner.play_one`. Simulator errors become the result."""
    result = runner.play_one(row.episode, watcher, wrap)
    return Replayed(result, differences(row, result))


def replay_rows(
    rows: Sequence[Row],
    sources: Mapping[str, PolicySource],
    environments: EnvironmentResolver,
    job: Job[Row],
    time_s: float = math.inf,
) -> Iterator[tuple[Row, Any | NotReplayed]]:
    """Replay rows in one process per simulator, in parallel, for at most `time_s`. Ray must be running.

    The rows, or snapshots if the job accepts them, of one simulator are processed in order.

    Yields:
        Each row with the job's result or `NotReplayed`, as it arrives.

    Raises:
        RayLost: Ray itself has died.
    """
    from robogauntlet.orchestrator.ray_runtime.simulator_processes import ProcessEnded, run_per_simulator  # imports Ray

    by_simulator: dict[str, list[Row]] = {}
    for row in rows:
        by_simulator.setdefault(row.simulator, []).append(row)
    arguments = {simulator: (job, its_rows, dict(sources)) for simulator, its_rows in by_simulator.items()}
    remaining = {simulator: iter(its_rows) for simulator, its_rows in by_simulator.items()}
    for simulator, result in run_per_simulator(_run_job, arguments, environments, time_s=time_s):
        if isinstance(result, ProcessEnded):
            yield from ((row, NotReplayed(simulator, result.reason)) for row in remaining[simulator])
        else:
            yield next(remaining[simulator]), result


def replay_with_video(
    row: EpisodeResult, sources: Mapping[str, PolicySource], video: Path, environments: EnvironmentResolver
) -> Replayed:
    """Replay a row's episode in the environment of its simulator, and write a video of it.

    Raises:
        AdapterError: The environment is unsuitable, or its process died.
        RayLost: Ray itself has died.
    """
    from robogauntlet.orchestrator.ray_runtime.simulator_processes import run_in_simulator_environment  # imports Ray

    job = partial(_record_video, video=video.absolute())
    arguments = (job, [row], dict(sources))
    (replayed,) = run_in_simulator_environment(_run_job, catalog.find(row.simulator), arguments, environments)
    return replayed


def _record_video(row: EpisodeResult, runner: EpisodeRunner, *, video: Path) -> Replayed:
    with VideoRecorder(video, steps=row.steps or row.horizon) as recorder:
        return replay(row, runner, recorder)


def _run_job(job: Job[Row], rows: Sequence[Row], sources: Mapping[str, PolicySource]) -> Iterator[Any]:
    runner = EpisodeRunner(sources)
    try:
        for row in rows:
            yield job(row, runner)
    finally:
        runner.close()


def differences(stored: EpisodeResult, now: EpisodeResult) -> tuple[str, ...]:
    """A line for each outcome field that differs between two records of an episode, except the policy's name."""
    return tuple(
        f"{name}: stored {json.dumps(getattr(stored, name))}, now {json.dumps(getattr(now, name))}"
        for name in OUTCOME
        if name != "policy" and getattr(stored, name) != getattr(now, name)
    )
