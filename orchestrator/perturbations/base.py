"""What every perturbation does alike: the clean world, and what was measured held against what was asked for."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.adapters.contract import Delivered, Image, NotDelivered, Observation, Simulation, UnsupportedCondition
from robogauntlet.adapters.wrapper import SimulationWrapper
from robogauntlet.orchestrator.perturbations.operators import generator_for
from robogauntlet.orchestrator.perturbations.reference_images import Images, ReferenceImages
from robogauntlet.suites.axes import Axis, Changes
from robogauntlet.suites.episode import CLEAN, Episode

Part = TypeVar("Part")


class Perturbed(SimulationWrapper):
    """A simulation in the clean world, with something between it and the policy."""

    def __init__(
        self, simulation: Simulation, axis: Axis, episode: Episode, references: ReferenceImages | None = None
    ) -> None:
        super().__init__(simulation)
        self.axis, self.episode = axis, episode
        self.references = references or ReferenceImages()
        self.level = axis.value(episode.condition.severity)
        self.secondary_level = axis.secondary_levels[episode.condition.severity - 1] if axis.secondary_levels else 0.0

    def reset(self, seed: int) -> None:
        """Start the clean episode of the seed; a subclass then changes what it changes."""
        self.simulation.reset(seed)
        self._clean_start = self.simulation.state_hash()
        self.generator = generator_for(self.episode.pair_id, 0)

    def preview(self) -> Observation:
        """What a look would show now, without counting as one: the next look shows what it would have shown anyway."""
        twin = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, dict | set):
                setattr(twin, name, value.copy())
        return twin.observe()

    def check_start(self) -> None:
        """Refuse a start that differs from the clean episode's in more than the axis changes, or not at all.

        Raises:
            NotDelivered: It does.
        """
        same = self.simulation.state_hash() == self._clean_start
        if same and not self.axis.changes.starts_clean:
            raise NotDelivered(f"{self.episode.condition}: expected another physical state than the clean one, got it")
        if not same and self.axis.changes.starts_clean:
            raise NotDelivered(f"{self.episode.condition}: expected the clean episode's physical state, got another")

    def check_instruction(self, told: str) -> None:
        """Refuse other words than the task's own on axes that change something else.

        Raises:
            NotDelivered: They are others.
        """
        if self.axis.changes is not Changes.INSTRUCTION and told != task_descriptions()[self.episode.task].instruction:
            raise NotDelivered(f"{self.episode.condition}: expected the task's own instruction, got '{told}'")

    def delivered(self) -> Delivered | None:
        """What was measured, see the axis."""
        raise NotImplementedError

    def offered(self, control: Part | None, what: str) -> Part:
        """An control that the simulation must have.

        Raises:
            UnsupportedCondition: It has not; `what` completes "this simulation does not let".
        """
        if control is None:
            raise UnsupportedCondition(f"{self.episode.condition}: this simulation does not let {what}")
        return control

    def checked(self, value: float) -> float:
        """Refuse what is farther from the level than the axis allows.

        Raises:
            NotDelivered: It is.
        """
        if not abs(value - self.level) <= self.axis.tolerance:
            raise NotDelivered(
                f"{self.episode.condition}: expected {self.level:g} {self.axis.unit}, delivered {value:.2f}"
            )
        return value


class Unperturbed(Perturbed):
    """The clean episode under another name."""

    def delivered(self) -> Delivered | None:
        """That nothing was changed."""
        return Delivered(self.level)


ImagePairs = Mapping[str, tuple[Image, Image]]
"""Camera to what it sees at the start of the clean episode and of this one."""


class PerturbedScene(Perturbed):
    """A scene that looks different and is the same to physics.

    What the first look shows is compared with what it would show in the clean episode, which costs one more rendering
    unless a reference was kept. Nothing is rendered for a policy that does not look.
    """

    def reset(self, seed: int) -> None:
        """Start the clean episode; a subclass then changes the scene."""
        super().reset(seed)
        self._found: Delivered | None = None

    def show_clean(self) -> None:
        """Show the scene as in the clean episode."""
        raise NotImplementedError

    def show_perturbed(self) -> None:
        """Show the perturbed scene again."""
        raise NotImplementedError

    def measured(self, looks: ImagePairs) -> tuple[float, dict[str, float]]:
        """What was delivered, in the unit of the axis, and other numbers by name.

        Raises:
            NotDelivered: It is not what was asked for.
        """
        raise NotImplementedError

    def observe(self) -> Observation:
        """What the cameras see.

        Raises:
            NotDelivered: The first look shows something else than was asked for.
        """
        if self._found is not None:
            return self.simulation.observe()
        clean = self.references.get(self.episode.seed, CLEAN, self.clean_images)
        seen = self.first_observation(clean)
        looks = {camera: (clean[camera], image) for camera, image in seen.images.items()}
        if not self.changed(looks):
            raise NotDelivered(
                f"{self.episode.condition}: expected other images than in the clean episode, got the same"
            )
        self._found = Delivered(*self.measured(looks))
        return seen

    def first_observation(self, clean: Images) -> Observation:
        """The first that the policy sees, beside what the clean episode shows."""
        return self.simulation.observe()

    def clean_images(self) -> Images:
        """What the clean episode shows first; the scene is perturbed before and after."""
        self.show_clean()
        images = self.simulation.observe().images
        self.show_perturbed()
        return images

    def changed(self, looks: ImagePairs) -> float:
        """Share of the pixels that are not as in the clean episode."""
        return float(np.mean([(clean != seen).any(axis=2).mean() for clean, seen in looks.values()]))

    def delivered(self) -> Delivered | None:
        """What the first look showed; nothing if there was none."""
        return self._found or Delivered(None)
