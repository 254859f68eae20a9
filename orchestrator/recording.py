"""Records one episode of an oracle: noise in the executed action, the clean action in the record.

A learner may act first, as it will when it is judged; the oracle takes over at a step drawn for the episode, finishes
it, and only that is recorded. So the record holds what to do where the learner's own mistakes lead (DAgger: Ross et
al., 2011, arXiv 1011.0686; one change of hands per episode: AggreVaTe, 2014, arXiv 1406.5979). What the oracle would
have done while the learner acted is left out unless it is asked for: a chunk of such answers repeats the same
correction for as long as nobody makes it, and a policy that executes chunks may make it several times over.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from adapters.contract import ACTION_NAMES, FloatArray, Observation, Simulation, StepOutcome
from orchestrator.around import Around
from orchestrator.runner import EpisodeRunner
from policies.contract import Policy, PolicyError, Query, Sees, check_chunk, check_fit
from policies.training.lerobot import EncodedEpisode, Recording, encode_episode
from policies.training.writing import Attempt
from results.record import Status
from suites.vocabulary import Condition, Episode

LEARNER_REPLANS_EVERY = 4
"""Steps of its chunk that a learner executes, as in the shipped suites."""

HANDS_OVER = 2**32 - 1
"""Keys the draw of the step at which a learner hands over; steps key those of the noise."""


@dataclass
class Learner:
    """A policy that acts until a step drawn for the episode, uniform over what the task allows."""

    policy: Policy
    episode: Episode
    longest: int
    """It hands over after fewer steps than this."""
    recorded: bool = False
    """Whether what the oracle would do while the learner acts is recorded too."""
    _chunk: list[FloatArray] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        if self.policy.spec.sees is not Sees.OBSERVATION:
            raise PolicyError(f"expected a learner that sees observations, got one that sees {self.policy.spec.sees}")
        self.hands_over = int(_generator(self.episode, HANDS_OVER).integers(self.longest))

    def begin(self, simulation: Simulation) -> None:
        """Start the episode anew.

        Raises:
            PolicyMismatch: The learner does not fit the simulation.
        """
        check_fit(self.policy.spec, simulation.action_spec, simulation.observation_spec)
        self.policy.reset([self.episode])
        self._chunk = []

    def action(self, observation: Observation, step: int) -> FloatArray:
        """What it executes in this step, shape (7,)."""
        if not self._chunk:
            (decision,) = self.policy.act([Query(self.episode, step, observation=observation)])
            self._chunk = list(check_chunk(decision.actions)[:LEARNER_REPLANS_EVERY])
        return self._chunk.pop(0)


class RecordedSimulation(Around):
    """A simulation that looks before every step, and executes something near what it is told.

    The recovery from the disturbance is what a policy can learn from (Laskey et al., DART, 2017, arXiv 1703.09327):
    the record says what the oracle wanted to do where the noise had led.
    """

    def __init__(self, simulation: Simulation, episode: Episode, noise: float, learner: Learner | None = None) -> None:
        """Record what is told.

        Args:
            simulation: Plays.
            episode: Keys the noise.
            noise: Deviation of the executed motion per axis, as a share of the largest motion in one step.
            learner: Acts first, without noise; what is told meanwhile is not executed, and recorded if it says so.
        """
        super().__init__(simulation)
        self._episode, self._noise, self._learner = episode, noise, learner
        self._observations: list[Observation] = []
        self._actions: list[FloatArray] = []
        self._success: list[bool] = []

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode, and the record."""
        self._observations, self._actions, self._success = [], [], []
        self.simulation.reset(seed, condition)
        if self._learner is not None:
            self._learner.begin(self.simulation)

    def step(self, action: FloatArray) -> StepOutcome:
        """Look, record, disturb, execute."""
        self._observations.append(self.simulation.observe())
        outcome = self.simulation.step(self._executed(action))
        self._actions.append(np.array(action))
        self._success.append(outcome.success)
        return outcome

    def _executed(self, action: FloatArray) -> FloatArray:
        step, spec = len(self._actions), self.action_spec
        if self._learner is not None and step < self._learner.hands_over:
            disturbed = self._learner.action(self._observations[-1], step)
        else:
            disturbed = np.array(action)
            disturbed[:6] += self._noise * spec.high[:6] * _generator(self._episode, step).standard_normal(6)
        disturbed[[ACTION_NAMES.index(name) for name in spec.ignored]] = 0.0
        return np.clip(disturbed, spec.low, spec.high)

    @property
    def recorded_steps(self) -> int:
        """Steps of the record; none if the learner needed no help."""
        return max(0, len(self._actions) - self._begin)

    @property
    def _begin(self) -> int:
        """The first step that is recorded."""
        return 0 if self._learner is None or self._learner.recorded else self._learner.hands_over

    def recording(self) -> Recording:
        """What has been recorded since the last reset; with a learner, since the oracle took over or from the start."""
        begin = self._begin
        seen = self._observations[begin:]
        return Recording(
            self._episode.seed,
            seen[0].instruction,
            self.action_spec.control_hz,
            np.stack([observation.proprioception for observation in seen]),
            np.stack(self._actions[begin:]),
            np.array(self._success[begin:]),
            {camera: [observation.images[camera] for observation in seen] for camera in seen[0].images},
        )


def demonstrate(
    runner: EpisodeRunner, episode: Episode, noise: float, learner: Policy | None = None, *, whole: bool = False
) -> tuple[Attempt, EncodedEpisode | None]:
    """Play and record one episode. Its id keys the noise: the same episode, the same record.

    Args:
        runner: Knows the episode's policy.
        episode: What to play.
        noise: See `RecordedSimulation`.
        learner: Acts during a part of the first half of the horizon.
        whole: Whether that part is recorded too: what the oracle would do where the learner acts.

    Returns:
        How it went, and the record if it succeeded; where the learner needed no help there is none, and the episode
        counts as a failure to demonstrate. Nothing is raised for what a simulator does.
    """
    records: list[RecordedSimulation] = []

    def record(simulation: Simulation) -> Simulation:
        first = Learner(learner, episode, episode.protocol.horizon // 2, whole) if learner else None
        records.append(RecordedSimulation(simulation, episode, noise, first))
        return records[-1]

    result = runner.play_one(episode, wrap=record)
    steps = records[-1].recorded_steps if records else 0
    status = Status.FAILURE if result.status == Status.SUCCESS and not steps else result.status
    attempt = Attempt(episode.seed, status, result.steps, result.error)
    return attempt, encode_episode(records[-1].recording()) if status == Status.SUCCESS else None


def _generator(episode: Episode, key: int) -> np.random.Generator:
    return np.random.default_rng([int(episode.id, 16), key])
