"""Perturbed actions: noise and delay."""

from __future__ import annotations

import math

import numpy as np

from robogauntlet.adapters.contract import ACTION_NAMES, Delivered, FloatArray, StepOutcome
from robogauntlet.orchestrator.perturbations.base import Perturbed
from robogauntlet.orchestrator.perturbations.operators import delay_steps, generator_for, step_deviation

OPEN_GRIPPER = -1.0


class PerturbedActions(Perturbed):
    """Steps are counted from the reset."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._steps = 0
        self.told: FloatArray | None = None
        """The last action that the policy told."""

    def step(self, action: FloatArray) -> StepOutcome:
        """Execute what becomes of the action."""
        self.told = np.array(action, dtype=np.float64)
        executed = self._executed(self.told.copy())
        self._steps += 1
        return self.simulation.step(executed)

    def _executed(self, action: FloatArray) -> FloatArray:
        raise NotImplementedError


class ActionNoise(PerturbedActions):
    """Noise in the executed translation."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._squares = 0.0

    def _executed(self, action: FloatArray) -> FloatArray:
        spec = self.action_spec
        generator = generator_for(self.episode.pair_id, self._steps)
        noisy = action.copy()
        noisy[:3] += step_deviation(self.level, spec.control_hz) * generator.standard_normal(3)
        noisy[[ACTION_NAMES.index(name) for name in spec.ignored]] = 0.0
        noisy = np.clip(noisy, spec.low, spec.high)
        self._squares += float(np.square(noisy[:3] - action[:3]).sum())
        return noisy

    def delivered(self) -> Delivered | None:
        """The deviation of what was executed from what was commanded, clipping included."""
        if not self._steps:
            return Delivered(None)
        per_step = math.sqrt(self._squares / (3 * self._steps))
        return Delivered(100 * per_step * math.sqrt(self.action_spec.control_hz))


class ActionDelay(PerturbedActions):
    """Actions that arrive late."""

    def reset(self, seed: int) -> None:
        """Start the episode, with nothing on its way."""
        super().reset(seed)
        still = np.zeros(len(ACTION_NAMES))
        still[ACTION_NAMES.index("gripper")] = 0.0 if "gripper" in self.action_spec.ignored else OPEN_GRIPPER
        self._underway = [still] * delay_steps(self.level, self.action_spec.control_hz)

    def _executed(self, action: FloatArray) -> FloatArray:
        self._underway.append(action)
        return self._underway.pop(0)

    def delivered(self) -> Delivered | None:
        """The delay in whole control steps."""
        return Delivered(self.checked(1000 * len(self._underway) / self.action_spec.control_hz))
