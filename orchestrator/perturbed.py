"""Perturbs what a policy sees and does, alike in every simulator, and measures what came of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from adapters.contract import (
    ACTION_NAMES,
    Delivered,
    FloatArray,
    Image,
    NotDelivered,
    Observation,
    Simulation,
    StepOutcome,
    UnsupportedCondition,
)
from suites.axes import Axis, axis_of, why_unsupported
from suites.operators import (
    add_noise,
    blur,
    delay_steps,
    generator_for,
    is_frozen,
    noise_deviation,
    psnr,
    step_deviation,
)
from suites.paraphrases import PARAPHRASES
from suites.vocabulary import Condition, Episode

OPEN_GRIPPER = -1.0
SATURATED = 255
PHASE = 2**32
"""Key of the draw that is made once per episode, beside those of looks and steps."""


def perturbed(simulation: Simulation, episode: Episode) -> Simulation:
    """The simulation as this episode's condition has it: itself, or with its images or actions perturbed.

    Draws depend on the pair alone, so that two policies meet the same disturbance.

    Raises:
        ValueError: There is no such axis or severity.
    """
    axis = axis_of(episode.condition)
    if axis is None:
        return simulation
    return _PERTURBED[axis.name](simulation, axis, episode)


class _Perturbed:
    """A simulation in the clean world, with something between it and the policy."""

    def __init__(self, simulation: Simulation, axis: Axis, episode: Episode) -> None:
        self._simulation, self._axis, self._episode = simulation, axis, episode
        self._level = axis.value(episode.condition.severity)
        self.action_spec, self.observation_spec = simulation.action_spec, simulation.observation_spec

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the clean episode of the seed: no such axis touches the world itself."""
        self._simulation.reset(seed, Condition())

    def observe(self) -> Observation:
        """As the simulation."""
        return self._simulation.observe()

    def step(self, action: FloatArray) -> StepOutcome:
        """As the simulation."""
        return self._simulation.step(action)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """As the simulation."""
        return self._simulation.privileged_state()

    def state_hash(self) -> str:
        """As the simulation."""
        return self._simulation.state_hash()

    def delivered(self) -> Delivered | None:
        """What was measured, see the axis."""
        raise NotImplementedError

    def picture(self) -> Image:
        """As the simulation."""
        return self._simulation.picture()

    def render_device(self) -> str:
        """As the simulation."""
        return self._simulation.render_device()

    def close(self) -> None:
        """As the simulation."""
        self._simulation.close()

    def _checked(self, value: float) -> float:
        """Refuse what is farther from the level than the axis allows.

        Raises:
            NotDelivered: It is.
        """
        if not abs(value - self._level) <= self._axis.tolerance:
            raise NotDelivered(
                f"{self._episode.condition}: expected {self._level:g} {self._axis.unit}, delivered {value:.2f}"
            )
        return value


class _PerturbedImages(_Perturbed):
    """Looks are counted from the reset; the first images are measured against what the cameras saw."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode."""
        super().reset(seed, condition)
        self._looks = 0
        self._statistics: dict[str, float] = {}

    def observe(self) -> Observation:
        """What the cameras see, perturbed."""
        seen = self._simulation.observe()
        images = {camera: self._image(image, number) for number, (camera, image) in enumerate(seen.images.items())}
        if self._looks == 0:
            self._statistics = _statistics(images, seen.images)
        self._looks += 1
        return replace(seen, images=images)

    def _image(self, image: Image, camera: int) -> Image:
        raise NotImplementedError


class _Noisy(_PerturbedImages):
    """Sensor noise."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode; deviations are found with the first look."""
        super().reset(seed, condition)
        self._deviations: dict[int, float] = {}

    def _image(self, image: Image, camera: int) -> Image:
        generator = generator_for(self._episode.pair_id, camera, self._looks)
        pattern = generator.standard_normal(image.shape, dtype=np.float32)
        if camera not in self._deviations:
            self._deviations[camera] = noise_deviation(image, self._level, pattern)
        return add_noise(image, self._deviations[camera], pattern)

    def delivered(self) -> Delivered | None:
        """The ratio of the first images; each camera's is held to the level."""
        if not self._statistics:
            return Delivered(None)
        ratios = [value for name, value in self._statistics.items() if name.startswith("psnr_")]
        for ratio in ratios:
            self._checked(ratio)
        return Delivered(float(np.mean(ratios)), self._statistics)


class _Blurred(_PerturbedImages):
    """A blur."""

    def _image(self, image: Image, camera: int) -> Image:
        return blur(image, self._level)

    def delivered(self) -> Delivered | None:
        """The deviation, once some image has changed by it: one without any edge cannot."""
        if not self._statistics:
            return Delivered(None)
        if all(math.isinf(value) for name, value in self._statistics.items() if name.startswith("psnr_")):
            raise NotDelivered(f"{self._episode.condition}: expected blurred images, got what the cameras saw")
        return Delivered(self._level, self._statistics)


class _Frozen(_PerturbedImages):
    """Frames that do not change."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode."""
        super().reset(seed, condition)
        self._phase = float(generator_for(self._episode.pair_id, PHASE).random())
        self._last: dict[int, Image] = {}
        self._repeated = 0

    def observe(self) -> Observation:
        """What the cameras see, or saw at the last look."""
        self._repeated += is_frozen(self._looks, self._level, self._phase)
        return super().observe()

    def _image(self, image: Image, camera: int) -> Image:
        if not is_frozen(self._looks, self._level, self._phase):
            self._last[camera] = image
        return self._last[camera]

    def delivered(self) -> Delivered | None:
        """The share of looks that repeated the one before; over few looks it is 0 or far above the level."""
        return Delivered(100 * self._repeated / self._looks if self._looks else None, self._statistics)


class _Reworded(_Perturbed):
    """The goal in other words."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode."""
        super().reset(seed, condition)
        self._told: set[tuple[str, str]] = set()

    def observe(self) -> Observation:
        """What the cameras see, with other words.

        Raises:
            UnsupportedCondition: There are none for this instruction.
        """
        seen = self._simulation.observe()
        reason = why_unsupported(self._axis, seen.instruction)
        if reason:
            raise UnsupportedCondition(f"{self._episode.condition}: {reason}")
        told = PARAPHRASES[seen.instruction][self._episode.condition.severity - 1]
        self._told.add((seen.instruction, told))
        return replace(seen, instruction=told)

    def delivered(self) -> Delivered | None:
        """The kind of rewording, if the words were others than the task's own."""
        if any(own == told for own, told in self._told):
            raise NotDelivered(f"{self._episode.condition}: expected other words than the task's own, got the same")
        return Delivered(self._level if self._told else None)


class _PerturbedActions(_Perturbed):
    """Steps are counted from the reset."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode."""
        super().reset(seed, condition)
        self._steps = 0

    def step(self, action: FloatArray) -> StepOutcome:
        """Execute what becomes of the action."""
        executed = self._executed(np.array(action, dtype=np.float64))
        self._steps += 1
        return self._simulation.step(executed)

    def _executed(self, action: FloatArray) -> FloatArray:
        raise NotImplementedError


class _NoisyActions(_PerturbedActions):
    """Noise in the executed translation."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode."""
        super().reset(seed, condition)
        self._squares = 0.0

    def _executed(self, action: FloatArray) -> FloatArray:
        spec = self.action_spec
        generator = generator_for(self._episode.pair_id, self._steps)
        noisy = action.copy()
        noisy[:3] += step_deviation(self._level, spec.control_hz) * generator.standard_normal(3)
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


class _Delayed(_PerturbedActions):
    """Actions that arrive late."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode, with nothing on its way."""
        super().reset(seed, condition)
        still = np.zeros(len(ACTION_NAMES))
        still[ACTION_NAMES.index("gripper")] = 0.0 if "gripper" in self.action_spec.ignored else OPEN_GRIPPER
        self._underway = [still] * delay_steps(self._level, self.action_spec.control_hz)

    def _executed(self, action: FloatArray) -> FloatArray:
        self._underway.append(action)
        return self._underway.pop(0)

    def delivered(self) -> Delivered | None:
        """The delay in whole control steps."""
        return Delivered(self._checked(1000 * len(self._underway) / self.action_spec.control_hz))


_PERTURBED: Mapping[str, type[_Perturbed]] = {
    "noise": _Noisy,
    "blur": _Blurred,
    "frozen-frames": _Frozen,
    "action-noise": _NoisyActions,
    "action-delay": _Delayed,
    "instruction": _Reworded,
}


def _statistics(images: Mapping[str, Image], seen: Mapping[str, Image]) -> dict[str, float]:
    """Of each camera: ratio to what it saw (dB), mean brightness and share of saturated values."""
    found = {}
    for camera, image in images.items():
        found[f"psnr_{camera}"] = psnr(image, seen[camera])
        found[f"mean_{camera}"] = float(image.mean())
        found[f"saturated_{camera}"] = float(((image == 0) | (image == SATURATED)).mean())
    return found
