"""Records one episode of an oracle: noise in the executed action, the clean action in the record."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from adapters.contract import ACTION_NAMES, FloatArray, Image, Observation, Simulation, StepOutcome
from orchestrator.runner import EpisodeRunner
from policies.training.lerobot import EncodedEpisode, Recording, encode_episode
from policies.training.writing import Attempt
from results.record import Status
from suites.vocabulary import Condition, Episode


class RecordedSimulation:
    """A simulation that looks before every step, and executes something near what it is told.

    The recovery from the disturbance is what a policy can learn from (Laskey et al., DART, 2017, arXiv 1703.09327):
    the record says what the oracle wanted to do where the noise had led.
    """

    def __init__(self, simulation: Simulation, episode: Episode, noise: float) -> None:
        """Args: noise: deviation of the executed motion per axis, as a share of the largest motion in one step."""
        self._simulation, self._episode, self._noise = simulation, episode, noise
        self.action_spec, self.observation_spec = simulation.action_spec, simulation.observation_spec
        self._observations: list[Observation] = []
        self._actions: list[FloatArray] = []
        self._success: list[bool] = []

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode, and the record."""
        self._observations, self._actions, self._success = [], [], []
        self._simulation.reset(seed, condition)

    def step(self, action: FloatArray) -> StepOutcome:
        """Look, record, disturb, execute."""
        self._observations.append(self._simulation.observe())
        outcome = self._simulation.step(self._disturbed(action))
        self._actions.append(np.array(action))
        self._success.append(outcome.success)
        return outcome

    def _disturbed(self, action: FloatArray) -> FloatArray:
        generator = np.random.default_rng([int(self._episode.id, 16), len(self._actions)])
        spec = self.action_spec
        disturbed = np.array(action)
        disturbed[:6] += self._noise * spec.high[:6] * generator.standard_normal(6)
        disturbed[[ACTION_NAMES.index(name) for name in spec.ignored]] = 0.0
        return np.clip(disturbed, spec.low, spec.high)

    def recording(self) -> Recording:
        """What has been recorded since the last reset."""
        first = self._observations[0]
        return Recording(
            self._episode.seed,
            first.instruction,
            self.action_spec.control_hz,
            np.stack([observation.proprioception for observation in self._observations]),
            np.stack(self._actions),
            np.array(self._success),
            {camera: [seen.images[camera] for seen in self._observations] for camera in first.images},
        )

    def observe(self) -> Observation:
        """As the simulation."""
        return self._simulation.observe()

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """As the simulation."""
        return self._simulation.privileged_state()

    def state_hash(self) -> str:
        """As the simulation."""
        return self._simulation.state_hash()

    def picture(self) -> Image:
        """As the simulation."""
        return self._simulation.picture()

    def render_device(self) -> str:
        """As the simulation."""
        return self._simulation.render_device()

    def close(self) -> None:
        """As the simulation."""
        self._simulation.close()


def demonstrate(runner: EpisodeRunner, episode: Episode, noise: float) -> tuple[Attempt, EncodedEpisode | None]:
    """Play and record one episode. Its id keys the noise: the same episode, the same record.

    Args:
        runner: Knows the episode's policy.
        episode: What to play.
        noise: See `RecordedSimulation`.

    Returns:
        How it went, and the record if it succeeded. Nothing is raised for what a simulator does.
    """
    records: list[RecordedSimulation] = []

    def record(simulation: Simulation) -> Simulation:
        records.append(RecordedSimulation(simulation, episode, noise))
        return records[-1]

    result = runner.play_one(episode, wrap=record)
    attempt = Attempt(episode.seed, result.status, result.steps, result.error)
    return attempt, encode_episode(records[-1].recording()) if result.status == Status.SUCCESS else None
