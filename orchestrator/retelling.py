"""Plays chosen episodes of a run again and writes what was seen and done as LeRobot datasets, one per task.

An episode is what its identity says, so a run need not keep frames for this: they are drawn again when they are wanted,
and an episode that comes out differently than its row is not kept.
"""

from __future__ import annotations

import heapq
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from adapters import catalog
from adapters.contract import FloatArray, Observation, Simulation, StepOutcome
from orchestrator.around import Around
from orchestrator.beside import Ended, beside
from orchestrator.cluster import RayLost, ray_session
from orchestrator.demonstrate import dataset_name
from orchestrator.environments.homes import Homes
from orchestrator.folders import explain, locked
from orchestrator.perturbations.actions import PerturbedActions
from orchestrator.perturbations.base import Perturbed
from orchestrator.replay import differences, episode_of
from orchestrator.runner import EpisodeRunner
from orchestrator.sources import PolicySource
from policies.training.lerobot import DatasetError, EncodedEpisode, Recording, encode_episode
from policies.training.writing import Attempt, DatasetWriter
from results.record import EpisodeResult, Status
from results.run import RunDocument, RunStatus
from suites.part import kept
from suites.vocabulary import Condition, content_hash

FLUSH_BYTES = 32 * 2**20
FLUSH_S = 10.0
PLAYED = (str(Status.FAILURE), str(Status.SUCCESS))
"""Statuses of episodes that can be played again; an error is nothing that was played."""
DESCRIBED = ("episode_id", "pair_id", "policy", "policy_digest", "axis", "severity", "status", "success_once")
"""Fields of the record that stand beside each episode, under `meta/episodes`."""


@dataclass(frozen=True)
class Choice:
    """Which episodes of a run are wanted; all failures by default."""

    policies: tuple[str, ...] = ()
    """Names, or patterns."""
    tasks: tuple[str, ...] = ()
    """`simulator/task`, or patterns."""
    conditions: tuple[str, ...] = ()
    """As `str(Condition)`: `clean`, `noise@3`, or patterns such as `noise@*`."""
    statuses: tuple[str, ...] = (str(Status.FAILURE),)
    limit: int | None = None
    """Of each task at most so many, drawn by the hashes of their ids: a larger limit adds to those of a smaller one."""

    def of(self, document: RunDocument, rows: Iterable[EpisodeResult]) -> list[EpisodeResult]:
        """The rows that are wanted, in the order in which they are played.

        Args:
            document: The run.
            rows: Of the run.

        Raises:
            NoSuchPart: A name or pattern that finds nothing in the run.
        """
        plan = document.plan
        policies = kept("policy", self.policies, list(dict.fromkeys(cell.policy for cell in plan)), whole="run")
        tasks = kept("task", self.tasks, list(dict.fromkeys(cell.task for cell in plan)), whole="run")
        every = list(dict.fromkeys(str(Condition(cell.axis, cell.severity)) for cell in plan))
        conditions = kept("condition", self.conditions, every, whole="run")
        wanted = (
            row
            for row in rows
            if row.status in self.statuses
            and row.policy in policies
            and row.task in tasks
            and str(Condition(row.axis, row.severity)) in conditions
        )
        drawn: dict[str, list[tuple[int, str, EpisodeResult]]] = {}
        for row in wanted:
            own = drawn.setdefault(row.task, [])
            full = self.limit is not None and len(own) >= self.limit
            rank = -int(content_hash(row.episode_id), 16)
            (heapq.heappushpop if full else heapq.heappush)(own, (rank, row.episode_id, row))
        found = [row for own in drawn.values() for _, _, row in own]
        return sorted(found, key=lambda row: (row.task, row.policy, row.axis, row.severity, row.seed))


class Witness(Around):
    """Remembers what a policy would see before each step and what it tells the robot to do, and changes neither.

    Between its looks a policy sees nothing: what is remembered there is what a look would have shown.
    """

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        self._outer: Simulation = self
        self._forget()

    def _forget(self) -> None:
        self._seen: list[Observation] = []
        self._told: list[FloatArray] = []
        self._success: list[bool] = []

    def watch(self, simulation: Simulation, step: int) -> None:
        """A `rollout` watcher, which is shown the simulation as the policy has it."""
        self._outer = simulation

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode, and the memory."""
        self._forget()
        self.simulation.reset(seed, condition)

    def step(self, action: FloatArray) -> StepOutcome:
        """Look without being noticed, remember, execute."""
        outer = self._outer
        self._seen.append(outer.glance() if isinstance(outer, Perturbed) else self.simulation.observe())
        told = outer.told if isinstance(outer, PerturbedActions) else None
        outcome = self.simulation.step(action)
        self._told.append(np.array(action if told is None else told))
        self._success.append(outcome.success)
        return outcome

    def recording(self, row: EpisodeResult) -> Recording:
        """What is remembered of the episode of this row."""
        seen = self._seen
        return Recording(
            row.seed,
            seen[0].instruction,
            self.action_spec.control_hz,
            np.stack([observation.proprioception for observation in seen]),
            np.stack(self._told),
            np.array(self._success),
            {camera: [observation.images[camera] for observation in seen] for camera in seen[0].images},
            {name: getattr(row, name) for name in DESCRIBED},
        )


@dataclass(frozen=True)
class Retold:
    """What came of playing an episode again."""

    row: EpisodeResult
    episode: EncodedEpisode | None
    trouble: str | None = None
    """Why there is none, in a line."""


def retell(row: EpisodeResult, runner: EpisodeRunner) -> Retold:
    """Play a row's episode again and record it. Nothing is raised for what a simulator does."""
    witnesses: list[Witness] = []

    def witness(simulation: Simulation) -> Simulation:
        witnesses.append(Witness(simulation))
        return witnesses[-1]

    result = runner.play_one(episode_of(row), lambda simulation, step: witnesses[-1].watch(simulation, step), witness)
    name = f"{row.episode_id} ({row.task}, {row.policy}, {Condition(row.axis, row.severity)}, seed {row.seed})"
    if result.status == Status.ERROR:
        return Retold(row, None, f"{name}: could not be played again: {result.error}")
    if found := differences(row, result):
        return Retold(row, None, f"{name}: came out differently and is left out: {found[0]}")
    try:
        return Retold(row, encode_episode(witnesses[-1].recording(row)))
    except DatasetError as error:
        return Retold(row, None, f"{name}: {error}")


@dataclass
class Written:
    """What a writing of datasets came to."""

    status: RunStatus = RunStatus.COMPLETE
    writers: dict[str, DatasetWriter] = field(default_factory=dict)
    """Task to its dataset."""
    wanted: int = 0
    there: int = 0
    """Of those wanted, how many an earlier writing had left there."""
    troubles: list[str] = field(default_factory=list)
    """A line for each episode or simulator that could not be had."""


def write_datasets(
    rows: Sequence[EpisodeResult],
    document: RunDocument,
    sources: Mapping[str, PolicySource],
    folder: Path,
    listener: Callable[[Written, int], Callable[[], None]],
    homes: Homes | None = None,
) -> Written:
    """Play rows again, a process per simulator beside each other, and write them; go on with what is there.

    Args:
        rows: Of the run, none of them an error, those of a task together.
        document: The run.
        sources: Its policies.
        folder: A dataset per task is made in it.
        listener: Told how many episodes are to be played; what it returns is told after each.
        homes: In which environment each simulator runs.

    Raises:
        DatasetError: The folder holds something else.
        FolderError: Another process writes there, or nobody can.
    """
    written = Written(wanted=len(rows))
    with locked(folder):
        for row in rows:
            if row.task not in written.writers:
                source = {"task": row.task, "run_id": document.run_id, "protocol": asdict(episode_of(row).protocol)}
                written.writers[row.task] = DatasetWriter(folder / dataset_name(row.task), source, keeps=PLAYED)
        there = {name for writer in written.writers.values() for name in writer.about("episode_id")}
        missing: dict[str, list[EpisodeResult]] = {}
        for row in rows:
            if row.episode_id not in there:
                missing.setdefault(row.simulator, []).append(row)
        written.there = len(rows) - sum(map(len, missing.values()))
        homes = homes or Homes()
        for simulator in list(missing):
            if reason := homes.missing_reason(catalog.find(simulator)):
                written.troubles.append(f"{simulator}: {len(missing.pop(simulator))} not played again: {reason}")
        if missing:
            _play(missing, sources, written, listener(written, sum(map(len, missing.values()))), homes)
    return written


def _play(
    missing: Mapping[str, list[EpisodeResult]],
    sources: Mapping[str, PolicySource],
    written: Written,
    listener: Callable[[], None],
    homes: Homes,
) -> None:
    waiting = _Waiting(written.writers)
    left = Counter({simulator: len(own) for simulator, own in missing.items()})
    try:
        try:
            with ray_session(address=None, workers=len(missing)):
                arguments = {name: (own, dict(sources)) for name, own in missing.items()}
                for simulator, came in beside(_retell_all, arguments, homes):
                    if isinstance(came, Ended):
                        written.troubles.append(f"{simulator}: {left[simulator]} not played again: {came.reason}")
                        continue
                    left[simulator] -= 1
                    if came.trouble is not None:
                        written.troubles.append(came.trouble)
                    waiting.add(came)
                    listener()
        finally:
            waiting.flush()
    except KeyboardInterrupt:
        written.status = RunStatus.INTERRUPTED
    except (OSError, RayLost) as error:
        written.status = RunStatus.STOPPED
        written.troubles.append(explain(error))


class _Waiting:
    """Episodes that came back and are not committed: a commit writes anew what is said of the whole dataset."""

    def __init__(self, writers: Mapping[str, DatasetWriter]) -> None:
        self._writers = writers
        self._waiting: dict[str, list[Retold]] = {}
        self._size, self._flushed_at = 0, -math.inf

    def add(self, came: Retold) -> None:
        """One came back; raises OSError."""
        if came.episode is None:
            return
        self._waiting.setdefault(came.row.task, []).append(came)
        self._size += came.episode.size
        if self._size > FLUSH_BYTES or time.monotonic() - self._flushed_at > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Commit; raises OSError."""
        waiting, self._waiting, self._size = self._waiting, {}, 0
        for task, came in waiting.items():
            attempts = [Attempt(one.row.seed, one.row.status, one.row.steps) for one in came]
            self._writers[task].commit(attempts, [one.episode for one in came if one.episode is not None])
        self._flushed_at = time.monotonic()


def _retell_all(rows: Sequence[EpisodeResult], sources: Mapping[str, PolicySource]) -> Iterator[Retold]:
    runner = EpisodeRunner(sources)
    try:
        for row in rows:
            yield retell(row, runner)
    finally:
        runner.close()
