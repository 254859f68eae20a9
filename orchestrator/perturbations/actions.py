"""Perturbed actions: noise and delay."""

from __future__ import annotations

import math

import numpy as np

from robogauntlet.adapters.body import NO_METRES
from robogauntlet.adapters.contract import (
    ACTION_DIM,
    ARM_PREFIXES,
    Delivered,
    FloatArray,
    StepOutcome,
    UnsupportedCondition,
)
from robogauntlet.adapters.motion import standing_still
from robogauntlet.orchestrator.perturbations.base import Perturbed, generator_for


class PerturbedActions(Perturbed):
    """Actions are changed between policy and simulation."""

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._steps = 0
        """Steps since the reset."""
        self.commanded = None

    def step(self, action: FloatArray) -> StepOutcome:
        """Execute the changed action."""
        self.commanded = np.array(action, dtype=np.float64)
        executed = self._executed(self.commanded.copy())
        self._steps += 1
        return self.simulation.step(executed)

    def _executed(self, action: FloatArray) -> FloatArray:
        raise NotImplementedError


class ActionNoise(PerturbedActions):
    """Noise in the executed translation, drawn for each arm independently.

    Joints get what moves the tool as far. Of targets it does not add up, since each stands for itself.
    """

    def reset(self, seed: int) -> None:
        """Start the episode."""
        super().reset(seed)
        self._squares = 0.0

    def _executed(self, action: FloatArray) -> FloatArray:
        spec = self.action_spec
        if spec.numbers:
            raise UnsupportedCondition(f"{self.episode.condition}: {NO_METRES}")
        low, high, moved, per_metre = self._reach()
        generator = generator_for(self.episode.pair_id, self._steps)
        noisy = action.copy()
        deviation = step_deviation(self.level, spec.control_hz)
        noisy[moved] += per_metre @ (deviation * generator.standard_normal(per_metre.shape[1]))
        noisy[spec.ignored_indices] = 0.0
        noisy = np.clip(noisy, low, high)
        change = noisy - (np.clip(action, low, high) if spec.joints else action)
        self._squares += float(np.square(np.linalg.pinv(per_metre) @ change[moved]).sum())
        return noisy

    def delivered(self) -> Delivered:
        """The deviation of the executed actions from the commanded ones, clipping included."""
        if not self._steps:
            return Delivered(None)
        per_step = math.sqrt(self._squares / (3 * self.action_spec.arms * self._steps))
        return Delivered(100 * per_step * math.sqrt(self.action_spec.control_hz))

    def _reach(self) -> tuple[FloatArray, FloatArray, list[int], FloatArray]:
        """Return what an action can be now, which n of its numbers move the tools, and how much for each metre.

        The last has shape (n, 3 * arms).
        """
        spec, low, high = self.action_spec, self.action_spec.low, self.action_spec.high
        if not spec.joints:
            moved = [arm * ACTION_DIM + axis for arm in range(spec.arms) for axis in range(3)]
            return low, high, moved, np.eye(len(moved))
        state, width = self.simulation.privileged_state(), len(spec.joints)
        per_metre = np.zeros((width * spec.arms, 3 * spec.arms))
        steps = np.array([joint.step for joint in spec.joints])
        for number, arm in enumerate(ARM_PREFIXES[: spec.arms]):
            own, there = slice(width * number, width * (number + 1)), spec.joints_of(number)
            per_metre[own, 3 * number : 3 * number + 3] = np.linalg.pinv(state[f"{arm}tcp_jacobian"][:3])
            if not spec.velocities:
                present = state[f"{arm}joint_targets"]
                low[there] = np.maximum(low[there], present - steps)
                high[there] = np.minimum(high[there], present + steps)
        moved = [index for number in range(spec.arms) for index in range(len(low))[spec.joints_of(number)]]
        return low, high, moved, spec.per_radian * per_metre


class ActionDelay(PerturbedActions):
    """Actions that arrive late."""

    def reset(self, seed: int) -> None:
        """Start the episode; the robot stays until the first action arrives."""
        super().reset(seed)
        spec = self.action_spec
        self._delayed = [standing_still(self.simulation)] * delay_steps(
            self.level, spec.control_hz, least=int(self.severity >= 1)
        )

    def _executed(self, action: FloatArray) -> FloatArray:
        self._delayed.append(action)
        return self._delayed.pop(0)

    def delivered(self) -> Delivered:
        """The delay in whole control steps."""
        step = 1000 / self.action_spec.control_hz
        return Delivered(self._checked(step * len(self._delayed), step))


class AnswerLatency(Perturbed):
    """Answers that take longer, which `episodes.timeline` plays; here it is measured."""

    def delivered(self) -> Delivered:
        """The additional latency in whole control steps."""
        step = 1000 / self.action_spec.control_hz
        return Delivered(self._checked(step * delay_steps(self.level, self.action_spec.control_hz, least=0), step))


def delay_steps(delay_ms: float, control_hz: float, least: int = 1) -> int:
    """The delay in control steps, the nearest number (of two, the larger), at least `least`."""
    return max(least, math.floor(delay_ms / 1000 * control_hz + 0.5))


def step_deviation(spread: float, control_hz: float) -> float:
    """Deviation (m) of each control step's noise, so that the sum over a second has the deviation `spread` (cm)."""
    return spread / 100 / math.sqrt(control_hz)
