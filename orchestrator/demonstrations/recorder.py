"""Records episodes of an oracle, with noise in the executed action and the clean action in the record.

A learner may act first, as in an evaluation. The oracle takes over at a step drawn for the episode and finishes it, and
only that part is recorded. So the record has correct actions for states that the learner's mistakes lead to (DAgger:
Ross et al., 2011, arXiv 1011.0686; one handover per episode: AggreVaTe, 2014, arXiv 1406.5979). The oracle's actions
while the learner acts are omitted by default: they repeat the same correction at every step until it is executed, and a
policy that executes chunks may then execute it several times.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from robogauntlet.adapters.contract import GRIPPER, ActionSpec, AdapterError, FloatArray, Observation, Simulation
from robogauntlet.orchestrator.demonstrations.task_queue import PlayedSeed
from robogauntlet.orchestrator.demonstrations.variation import Variation
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.orchestrator.episodes.trajectory_recorder import TrajectoryRecorder
from robogauntlet.orchestrator.perturbations.base import PerturbedSimulation
from robogauntlet.policies.contract import Policy, PolicyError, PolicyInput, Query, check_chunk, check_fit
from robogauntlet.policies.training.dataset_writer import Attempt
from robogauntlet.policies.training.lerobot_format import EncodedEpisode, encode_episode
from robogauntlet.results.record import Status
from robogauntlet.suites.episode import Episode
from robogauntlet.support.errors import first_line

LEARNER_REPLANS_EVERY = 4
"""Steps of a learner's chunk that are executed before its next query."""

HANDOVER_KEY = 2**32 - 1
"""Random key of the handover step; noise is keyed by the step."""


@dataclass
class Learner:
    """A policy that acts until a handover step, which is drawn uniformly for the episode."""

    policy: Policy
    episode: Episode
    limit: int
    """The handover step is below this."""
    recorded: bool = False
    """Whether the oracle's actions are also recorded while the learner acts."""
    _chunk: list[FloatArray] = field(default_factory=list, init=False)
    _spec: ActionSpec = field(init=False)

    def __post_init__(self) -> None:
        if self.policy.spec.sees is not PolicyInput.OBSERVATION:
            raise PolicyError(f"expected a learner that sees observations, got one that sees {self.policy.spec.sees}")
        self.handover_step = int(_generator(self.episode, HANDOVER_KEY).integers(self.limit))

    def begin(self, simulation: Simulation) -> None:
        """Start the episode. Raises PolicyMismatch if the learner does not fit the simulation."""
        check_fit(self.policy.spec, simulation.action_spec, simulation.observation_spec)
        self.policy.reset([self.episode])
        self._chunk, self._spec = [], simulation.action_spec

    def action(self, observation: Observation, step: int) -> FloatArray:
        """The action to execute in this step, shape (numbers of an action,)."""
        if not self._chunk:
            (decision,) = self.policy.act([Query(self.episode, step, observation=observation, action_spec=self._spec)])
            self._chunk = list(check_chunk(decision.actions, len(self._spec.high))[:LEARNER_REPLANS_EVERY])
        return self._chunk.pop(0)


class RecordedSimulation(TrajectoryRecorder):
    """Records the commanded action and executes a noisy one.

    A policy can learn to recover from disturbances (DART: Laskey et al., 2017, arXiv 1703.09327), because the record
    has the oracle's actions in the states that the noise led to.
    """

    def __init__(self, simulation: Simulation, episode: Episode, noise: float, learner: Learner | None = None) -> None:
        """Wrap a simulation for an episode, whose id keys the noise.

        Args:
            simulation: The simulation.
            episode: The episode.
            noise: Deviation of the executed motion per axis, as a share of the largest motion in one step.
            learner: Acts first, without noise. Until the handover the commanded actions are not executed.
        """
        super().__init__(simulation)
        self._episode, self._noise, self._learner = episode, noise, learner

    def reset(self, seed: int) -> None:
        """Start the episode, the record and the learner."""
        super().reset(seed)
        if self._learner is not None:
            self._learner.begin(self.simulation)

    def _executed(self, action: FloatArray) -> FloatArray:
        step, spec = len(self._actions), self.action_spec
        if self._learner is not None and step < self._learner.handover_step:
            disturbed = self._learner.action(self._observations[-1], step)
        else:
            disturbed, generator = np.array(action), _generator(self._episode, step)
            moved = [place for place, name in enumerate(spec.names) if not name.endswith(GRIPPER)]
            disturbed[moved] += self._noise * spec.steps[moved] * generator.standard_normal(len(moved))
        disturbed[spec.ignored_indices] = 0.0
        return np.clip(disturbed, spec.low, spec.high)

    @property
    def first_step(self) -> int:
        """The handover step, or 0 if the oracle's earlier actions are recorded too."""
        return 0 if self._learner is None or self._learner.recorded else self._learner.handover_step


def demonstrate(
    runner: EpisodeRunner, episode: Episode, noise: float, learner: Policy | None = None, *, whole: bool = False
) -> tuple[Attempt, EncodedEpisode | None]:
    """Play and record one episode. The same episode always gives the same record.

    Args:
        runner: A runner with the episode's policy.
        episode: The episode.
        noise: See `RecordedSimulation`.
        learner: Acts until a step in the first half of the horizon.
        whole: Whether the oracle's actions are also recorded while the learner acts.

    Returns:
        The attempt, and the record if it succeeded. An episode that the learner finished alone has no record and
        counts as a failure. Simulator errors are not raised.
    """
    records: list[RecordedSimulation] = []

    def record(simulation: Simulation) -> Simulation:
        first = Learner(learner, episode, episode.protocol.horizon // 2, whole) if learner else None
        records.append(RecordedSimulation(simulation, episode, noise, first))
        return records[-1]

    def watch(simulation: Simulation, step: int) -> None:
        records[-1].watch(simulation, step)
        if step == 0 and isinstance(simulation, PerturbedSimulation):
            simulation.observe()  # which checks the images; the oracle does not look

    result = runner.play_one(episode, watch, wrap=record)
    steps = records[-1].recorded_steps if records else 0
    status = Status.FAILURE if result.status == Status.SUCCESS and not steps else result.status
    attempt = Attempt(episode.seed, status, result.steps, result.error)
    return attempt, encode_episode(records[-1].recording()) if status == Status.SUCCESS else None


class DemonstrationJob:
    """A worker's `Job` that plays and records demonstrations; for the arguments see `demonstrate`."""

    def __init__(
        self,
        noise: float,
        learner: PolicySource | None = None,
        *,
        whole: bool = False,
        variation: Variation | None = None,
    ) -> None:
        self._noise, self._source, self._whole = noise, learner, whole
        self._variation = variation or Variation({})
        self._learner: Policy | None = None
        self._task: str | None = None

    def __call__(self, runner: EpisodeRunner, lease: Lease) -> Iterator[PlayedSeed]:
        """Play a lease.

        Raises:
            AdapterError: The task cannot be opened here.
            PolicyError: The learner cannot be loaded.
        """
        if self._source is not None and self._learner is None:
            self._learner = build_policy(self._source)
        if self._task != lease.cell.task:
            try:
                runner.prepare(lease.cell.task, lease.cell.protocol.view)
            except Exception as error:  # a missing driver can raise anything
                raise AdapterError(first_line(error)) from None
            self._task = lease.cell.task
        for clean in lease.episodes():
            start = time.perf_counter()
            episode = replace(clean, condition=self._variation.condition(clean.task, clean.seed))
            attempt, record = demonstrate(runner, episode, self._noise, self._learner, whole=self._whole)
            yield PlayedSeed(attempt, record, time.perf_counter() - start)


def _generator(episode: Episode, key: int) -> np.random.Generator:
    return np.random.default_rng([int(episode.id, 16), key])
