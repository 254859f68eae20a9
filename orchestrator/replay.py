"""Plays a stored episode again from its identity, and says whether it came out the same."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from adapters import catalog
from adapters.contract import AdapterError
from orchestrator.environments.homes import Homes
from orchestrator.runner import EpisodeRunner
from orchestrator.sources import PolicySource
from orchestrator.video import Made, Recorder, save_png
from orchestrator.worker_environment import worker_environment
from policies import catalog as policies
from policies.contract import PolicyError
from results.media import picture_path, video_path
from results.record import OUTCOME, EpisodeResult
from results.run import RunDocument
from suites.environments import EnvironmentEntry
from suites.loading import SuiteError
from suites.vocabulary import Condition, Episode, Protocol, RenderProfile, View


class ReplayError(Exception):
    """An episode that cannot be replayed; the message says why."""


@dataclass(frozen=True)
class Replayed:
    """What came of a replay."""

    result: EpisodeResult
    differences: tuple[str, ...]
    """A line for each outcome field that differs from the stored row; empty if it is the same."""
    video: Path


def episode_of(row: EpisodeResult) -> Episode:
    """The episode that a row is the record of."""
    view = View(tuple(row.cameras.split(",")), row.image_size, RenderProfile(row.render_profile))
    protocol = Protocol(row.horizon, row.replan_every, view)
    return Episode(row.policy, row.policy_digest, row.task, row.seed, protocol, Condition(row.axis, row.severity))


def policy_sources(document: RunDocument) -> dict[str, PolicySource]:
    """The policies that a run played, as its suite names them.

    Raises:
        ReplayError: A policy is not what it was during the run.
    """
    import yaml

    from suites.schema import PolicyEntry

    try:
        entries = [PolicyEntry.model_validate(entry) for entry in yaml.safe_load(document.suite_text)["policies"]]
    except (yaml.YAMLError, SuiteError, KeyError, TypeError, ValueError) as error:
        raise ReplayError(f"the run's suite cannot be read: {error}") from None
    begun = {cell.policy: cell.policy_digest for cell in document.plan}
    sources, homes = {}, homes_of(document)
    for entry in entries:
        if entry.name not in begun:  # a part of a suite leaves policies out
            continue
        try:
            options = homes.options(entry.kind, entry.options)
        except PolicyError as error:
            raise ReplayError(f"policy '{entry.name}': {error}") from None
        if policies.digest(entry.kind, options) != begun[entry.name]:
            raise ReplayError(f"policy '{entry.name}' has changed since the run; check out the commit of the run")
        sources[entry.name] = PolicySource(entry.kind, options)
    return sources


def homes_of(document: RunDocument) -> Homes:
    """In which environment each simulator of a run lives, as its suite and the user's configuration say.

    Raises:
        ReplayError: They cannot be read.
    """
    import yaml

    try:
        declared = (yaml.safe_load(document.suite_text) or {}).get("environments") or {}
        return Homes({name: EnvironmentEntry.model_validate(entry) for name, entry in declared.items()})
    except (yaml.YAMLError, SuiteError, AttributeError, ValueError) as error:
        raise ReplayError(f"the run's environments cannot be told: {error}") from None


def replay(row: EpisodeResult, runner: EpisodeRunner, video: Path, *, picture: Path | None = None) -> Replayed:
    """Play the row's episode again and film it.

    Args:
        row: A stored row.
        runner: Knows the run's policies.
        video: The mp4 to write.
        picture: A PNG of the first frame to write too.

    Raises:
        ReplayError: Videos cannot be written.
    """
    partial = video.with_name(f".{video.name}.partial.mp4")
    recorder = Recorder(partial, steps=row.steps or row.horizon)
    try:
        result = runner.play_one(episode_of(row), recorder)
    finally:
        recorder.close()
    if partial.exists():
        partial.replace(video)
    if picture is not None and recorder.first is not None:
        save_png(picture, recorder.first)
    return Replayed(result, tuple(differences(row, result)), video)


def replay_at_home(row: EpisodeResult, sources: Mapping[str, PolicySource], video: Path, homes: Homes) -> Replayed:
    """Play the row's episode again and film it: in this process, or in the environment that its simulator lives in.

    Raises:
        ReplayError: The environment does not fit, or its process ended.
        RayLost: Ray has died, which carries the process in another environment.
    """
    simulator = catalog.find(row.simulator)
    if homes.of(simulator) is None:
        os.environ.update(worker_environment(simulator))
        (done,) = _replayed(row, sources, video)
        return done
    from orchestrator.beside import alone

    try:
        came = alone(_replayed, simulator, (row, dict(sources), video.absolute()), homes)
    except AdapterError as error:
        raise ReplayError(str(error)) from None
    return replace(came[0], video=video)


def _replayed(row: EpisodeResult, sources: Mapping[str, PolicySource], video: Path) -> Iterator[Replayed]:
    runner = EpisodeRunner(sources)
    try:
        yield replay(row, runner, video)
    finally:
        runner.close()


def differences(stored: EpisodeResult, now: EpisodeResult) -> list[str]:
    """A line for each outcome field in which two records of an episode differ, the policy's name aside."""
    return [
        f"{name}: stored {json.dumps(getattr(stored, name))}, now {json.dumps(getattr(now, name))}"
        for name in OUTCOME
        if name != "policy" and getattr(stored, name) != getattr(now, name)
    ]


def film(rows: Sequence[EpisodeResult], folder: Path, sources: Mapping[str, PolicySource]) -> Iterator[Made]:
    """Film the rows into a run folder, and picture each task once; row by row."""
    runner = EpisodeRunner(sources, "camera")
    try:
        for row in rows:
            video, picture = video_path(folder, row.episode_id), picture_path(folder, row.task)
            wanted = [video] if picture.exists() else [video, picture]
            done = replay(row, runner, video, picture=picture if picture in wanted else None)
            trouble = None
            if done.differences:
                done.video.unlink(missing_ok=True)
                trouble = f"replay differs: {row.episode_id} ({row.task}, {row.policy}): {done.differences[0]}"
            yield Made(tuple(path for path in wanted if path.exists()), trouble)
    finally:
        runner.close()
