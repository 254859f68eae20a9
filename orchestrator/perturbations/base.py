"""Base classes of perturbations. They change the clean simulation and check what was delivered."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.adapters.contract import (
    Delivered,
    FloatArray,
    Image,
    NotDelivered,
    Observation,
    Simulation,
    UnsupportedCondition,
)
from robogauntlet.adapters.wrapper import SimulationWrapper
from robogauntlet.suites.axis import Axis, Changes
from robogauntlet.suites.episode import CLEAN, Episode

Control = TypeVar("Control")
Images = Mapping[str, Image]
"""Camera to its image, each of shape (h, w, 3)."""
ImagePairs = Mapping[str, tuple[Image, Image]]
"""Camera to its first image in the clean and in the perturbed episode."""
MAX_REFERENCES = 512
"""Images that are kept: 28 MB with two cameras of 96 px."""


def generator_for(key: str, *numbers: int) -> np.random.Generator:
    """A generator that depends only on a hash (hexadecimal digits) and numbers, not on earlier draws."""
    return np.random.default_rng([int(key, 16), *numbers])


class ReferenceImages:
    """A cache of the first images of a seed's episode, in the clean scene or in one that is painted to measure it.

    Many conditions and policies are compared with the same images. Equal seeds give images that are equal to the bit,
    so the cache changes no result, and saves one rendering per episode.
    """

    def __init__(self, size: int = MAX_REFERENCES) -> None:
        self._size = size
        self._images: dict[tuple[int, str], Images] = {}
        """The most recently used last."""

    def get(self, seed: int, scene: str, render: Callable[[], Images]) -> Images:
        """The images of a seed's scene, rendered if they are not in the cache."""
        images = self._images.pop((seed, scene), None) or render()
        self._images[seed, scene] = images
        if len(self._images) > self._size:
            del self._images[next(iter(self._images))]
        return images


class PerturbedSimulation(SimulationWrapper):
    """A simulation under a condition other than clean, which is checked and measured."""

    commanded: FloatArray | None = None
    """The policy's last action, if the condition changes actions."""

    def preview(self) -> Observation:
        """The observation that the policy would get now. Later observations are the same as without this call."""
        raise NotImplementedError

    def check_start(self) -> None:
        """Check that the physical state differs from that of the clean episode only if the condition changes it.

        Raises:
            NotDelivered: It differs and must not, or the other way round.
        """
        raise NotImplementedError

    def check_instruction(self, instruction: str) -> None:
        """Check that only an axis of the instruction changes the instruction.

        Raises:
            NotDelivered: Another axis has changed it.
        """
        raise NotImplementedError

    def delivered(self) -> Delivered:
        """What was measured in this episode.

        Raises:
            NotDelivered: An axis' tolerance is exceeded.
        """
        raise NotImplementedError


class Perturbed(PerturbedSimulation):
    """A wrapper that applies one axis to a simulation: the clean one, or one that another axis perturbs already."""

    def __init__(
        self, simulation: Simulation, axis: Axis, episode: Episode, references: ReferenceImages | None = None
    ) -> None:
        """Args: `episode` is under the condition of this axis alone."""
        super().__init__(simulation)
        self.axis, self.episode = axis, episode
        self.references = references or ReferenceImages()
        (perturbation,) = episode.condition.perturbations
        self.severity = perturbation.severity
        self.level, self.secondary_level = axis.value(self.severity), axis.secondary_value(self.severity)
        self.must_show = self.severity >= 1
        """Whether unchanged images are an error. A milder change may not show in eight bits."""

    def reset(self, seed: int) -> None:
        """Start the episode of the seed without this axis; subclasses then perturb it."""
        self.simulation.reset(seed)
        if isinstance(self.simulation, Perturbed):
            self.simulation.check_start()
        self._clean_start = self.simulation.state_hash()
        self.generator = generator_for(self.episode.pair_id, 0)

    def preview(self) -> Observation:
        """The observation of a copy."""
        return self._twin().observe()

    def _twin(self) -> Perturbed:
        """A copy whose observations change nothing in this wrapper, nor in those below it."""
        twin = copy.copy(self)
        twin.generator = copy.deepcopy(self.generator)
        for name, value in vars(self).items():
            if isinstance(value, dict | set):
                setattr(twin, name, value.copy())
        if isinstance(self.simulation, Perturbed):
            twin.simulation = self.simulation._twin()
        return twin

    def check_start(self) -> None:
        """Check the physical state against the one before this axis was applied."""
        same = self.simulation.state_hash() == self._clean_start
        if same and not self.axis.changes.starts_clean:
            raise self._not_delivered("expected a physical state other than the clean one, got the clean one")
        if not same and self.axis.changes.starts_clean:
            raise self._not_delivered("expected the clean episode's physical state, got another")

    def check_instruction(self, instruction: str) -> None:
        """Check that the instruction is the task's own, unless the axis changes it."""
        task = task_descriptions()[self.episode.task]
        if self.axis.changes is not Changes.INSTRUCTION and instruction != task.instruction and not task.own_words:
            raise self._not_delivered(f"expected the task's own instruction, got '{instruction}'")

    def _not_delivered(self, message: str) -> NotDelivered:
        return NotDelivered(f"{self.episode.condition}: {message}")

    def _required(self, control: Control | None, what: str) -> Control:
        """A scene control, or UnsupportedCondition: `what` completes "this simulation does not let"."""
        if control is None:
            raise UnsupportedCondition(f"{self.episode.condition}: this simulation does not let {what}")
        return control

    def _checked(self, value: float, quantum: float = 0.0) -> float:
        """The value, or NotDelivered if it is farther from the level than the axis' tolerance and half the quantum."""
        if not abs(value - self.level) <= max(self.axis.tolerance, 0.5 * quantum + 1e-9):
            raise self._not_delivered(f"expected {self.level:g} {self.axis.unit}, delivered {value:.2f}")
        return value


class Unperturbed(Perturbed):
    """The clean episode under another name."""

    def delivered(self) -> Delivered:
        """Nothing is changed, and nothing measured."""
        return Delivered(None)


class PerturbedScene(Perturbed):
    """A scene with another appearance and the same physics.

    The first images are compared with those of the clean episode. That costs one more rendering, unless they are among
    the references. Nothing is rendered for a policy that does not observe.
    """

    def reset(self, seed: int) -> None:
        """Start the clean episode; subclasses then change the scene."""
        super().reset(seed)
        self._delivered: Delivered | None = None

    def observe(self) -> Observation:
        """The observation in the perturbed scene.

        Raises:
            NotDelivered: The first images do not show the requested level.
        """
        if self._delivered is not None:
            return self.simulation.observe()
        clean = self.references.get(self.episode.seed, CLEAN, self.clean_images)
        observation = self._first_observation(clean)
        pairs = {camera: (clean[camera], image) for camera, image in observation.images.items()}
        if self.must_show and not self._changed_share(pairs):
            raise self._not_delivered("expected other images than in the clean episode, got the same")
        self._delivered = Delivered(*self._measured(pairs))
        return observation

    def clean_images(self) -> Images:
        """The first images of the clean episode. The scene is perturbed before and after the call."""
        self._show(perturbed=False)
        images = self.simulation.observe().images
        self._show(perturbed=True)
        return images

    def delivered(self) -> Delivered:
        """The measurement in the first images; without a value if the policy did not observe."""
        return self._delivered or Delivered(None)

    def _show(self, *, perturbed: bool) -> None:
        """Show the perturbed or the clean scene."""

    def _first_observation(self, clean: Images) -> Observation:
        return self.simulation.observe()

    def _measured(self, pairs: ImagePairs) -> tuple[float | None, dict[str, float]]:
        """The delivered value in the unit of the axis, None if images cannot show it, and statistics.

        Raises:
            NotDelivered: The axis' tolerance is exceeded.
        """
        raise NotImplementedError

    def _changed_share(self, pairs: ImagePairs) -> float:
        """Share of the pixels that differ from the clean episode."""
        return float(np.mean([(clean != seen).any(axis=2).mean() for clean, seen in pairs.values()]))
