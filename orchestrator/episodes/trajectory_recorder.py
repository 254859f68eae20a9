"""Records the trajectory of an episode: observation, commanded action and success at every control step."""

from __future__ import annotations

import numpy as np

from robogauntlet.adapters.contract import FloatArray, Observation, Simulation, StepOutcome
from robogauntlet.adapters.wrapper import SimulationWrapper
from robogauntlet.orchestrator.perturbations.base import PerturbedSimulation
from robogauntlet.policies.training.lerobot_format import Recording


class TrajectoryRecorder(SimulationWrapper):
    """Records the policy's observation before each step and the action that it commands, without changing either.

    The recorder is wrapped by a perturbation; `watch` gives it the perturbed simulation, as the policy observes it.
    """

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        self._outer: Simulation = self
        self._clear(0)

    def _clear(self, seed: int) -> None:
        self._seed = seed
        self._observations: list[Observation] = []
        self._actions: list[FloatArray] = []
        self._success: list[bool] = []

    def watch(self, simulation: Simulation, step: int) -> None:
        """Receive the perturbed simulation, as a `rollout` watcher."""
        self._outer = simulation

    def reset(self, seed: int) -> None:
        """Start an episode with an empty record."""
        self._clear(seed)
        self.simulation.reset(seed)

    def step(self, action: FloatArray) -> StepOutcome:
        """Observe, execute and record."""
        outer = self._outer
        self._observations.append(
            outer.preview() if isinstance(outer, PerturbedSimulation) else self.simulation.observe()
        )
        commanded = outer.commanded if isinstance(outer, PerturbedSimulation) else None
        outcome = self.simulation.step(self._executed(action))
        self._actions.append(np.array(action if commanded is None else commanded))
        self._success.append(outcome.success)
        return outcome

    def _executed(self, action: FloatArray) -> FloatArray:
        """The action to execute; a subclass may add noise."""
        return action

    @property
    def first_step(self) -> int:
        """The first recorded step; a subclass may leave out earlier ones."""
        return 0

    @property
    def recorded_steps(self) -> int:
        """Number of steps in the record."""
        return max(0, len(self._actions) - self.first_step)

    def recording(self) -> Recording:
        """The record since the last reset, of at least one step."""
        first = self.first_step
        observations = self._observations[first:]
        return Recording(
            self._seed,
            observations[0].instruction,
            self.action_spec.control_hz,
            np.stack([observation.proprioception for observation in observations]),
            np.stack(self._actions[first:]),
            np.array(self._success[first:]),
            {camera: [each.images[camera] for each in observations] for camera in observations[0].images},
            self.action_spec.body,
        )
