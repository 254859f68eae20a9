"""Things to be seen on the table, and a table that looks different."""

from __future__ import annotations

import math

import numpy as np

from robogauntlet.adapters.camera_geometry import aim_point
from robogauntlet.adapters.contract import FloatArray, NotDelivered, Observation
from robogauntlet.adapters.photometry import difference, encoded, lab, light_of_lab, linear
from robogauntlet.adapters.scene_control import Form, Prop, TableControl
from robogauntlet.orchestrator.perturbations.base import ImagePairs, PerturbedScene
from robogauntlet.orchestrator.perturbations.cameras import THIRD_PERSON
from robogauntlet.orchestrator.perturbations.reference_images import Images
from robogauntlet.orchestrator.perturbations.textures import PATTERNS, painted, pattern

TASKS_COLOURS = ((0.85, 0.1, 0.1), (0.1, 0.65, 0.15), (0.1, 0.2, 0.85))
"""Red, green and blue, like the tasks' own things."""
OTHER_COLOURS = (
    (0.95, 0.8, 0.1),
    (0.95, 0.5, 0.1),
    (0.5, 0.15, 0.6),
    (0.1, 0.7, 0.75),
    (0.9, 0.5, 0.7),
    (0.35, 0.2, 0.1),
)
SIZES = (0.03, 0.05)
"""Smallest and largest prop (m)."""
CLEAR = 0.05
"""Least distance of a prop from the task's things and the way between them, all taken as round (m)."""
THING = 0.03
"""Radius of a task's thing (m)."""
WINDOW = np.array([0.22, 0.28])
"""Props stand within this of what the third-person camera is aimed at (m): x, y."""
DRAWS = 400
WIDENING = 1.25
"""Of the window after so many draws without a free place."""
NEAREST = 0.2
"""Least distance of a prop from the robot's base, forwards (m)."""

VISIBLE = 0.1
"""Linear light by which white paint must differ from black for a pixel to be the table's."""
LEAST_TABLE = 0.03
"""Share of the image that the table must have."""
MARGIN = 0.005
"""Linear light that is kept from black and white paint."""


class Staged(PerturbedScene):
    """A stage that must be there."""

    def reset(self, seed: int) -> None:
        """Start the clean episode.

        Raises:
            UnsupportedCondition: This simulation has no stage.
        """
        super().reset(seed)
        self._stage: TableControl = self.offered(self.scene_controls.stage, "its table be changed")


class Distractors(Staged):
    """Distractors."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then put things on the table."""
        super().reset(seed)
        self._props = self._drawn()
        self._stage.show(self._props)

    def show_clean(self) -> None:
        """Take them away."""
        self._stage.show(())

    def show_perturbed(self) -> None:
        """Put them back."""
        self._stage.show(self._props)

    def measured(self, looks: ImagePairs) -> tuple[float, dict[str, float]]:
        """How many there are, and the share of the pixels that they cover."""
        return self.checked(len(self._stage.shown())), {"covered": self.changed(looks)}

    def _drawn(self) -> list[Prop]:
        state = self.simulation.privileged_state()
        things = [where[:2] for name, where in state.items() if name.endswith("_position")]
        cameras = self.offered(self.scene_controls.cameras, "cameras be read")
        aim = aim_point(cameras.viewpoint(THIRD_PERSON), self._stage.table_height)[:2]
        generator, window = self.generator, WINDOW
        props: list[Prop] = []
        draws = 0
        while len(props) < self.level:
            size, yaw = generator.uniform(*SIZES), generator.uniform(0.0, math.pi)
            form = list(Form)[generator.integers(len(Form))]
            place = aim + window * generator.uniform(-1.0, 1.0, 2)
            draws += 1
            if draws % DRAWS == 0:
                window = window * WIDENING
            if place[0] < NEAREST or not _is_free(place, size, things, props):
                continue
            colours = TASKS_COLOURS if len(props) % 2 == 0 else OTHER_COLOURS
            colour = colours[generator.integers(len(colours))]
            props.append(Prop(form, np.array([*place, self._stage.table_height + size / 2]), size, yaw, colour))
        return props


def _is_free(place: FloatArray, size: float, things: list[FloatArray], props: list[Prop]) -> bool:
    """Whether a prop of that size may stand there: the task's things are visited one after the other."""
    radius = size / math.sqrt(2)
    ways = zip(things, things[1:] or things, strict=False)
    if any(from_segment(place, start, end) < CLEAR + radius + THING for start, end in ways):
        return False
    return all(np.linalg.norm(place - p.position[:2]) >= radius + p.size / math.sqrt(2) + CLEAR / 2 for p in props)


def from_segment(point: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Distance of a point from the straight way between two others."""
    way = end - start
    along = float(np.clip((point - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(point - start - along * way))


class Table(Staged):
    """A table of another colour.

    How much of the light that falls on the table reaches the camera is found by painting it black and white, once for a
    seed; so is where the table is in the image. The colour is then chosen in the image, and set right where the
    renderer differs.
    """

    corrections = 4
    """Times that the colour is set anew because it is off by more than half of what is allowed."""

    def show_clean(self) -> None:
        """Nothing is painted before the first look."""

    def show_perturbed(self) -> None:
        """Nor is it painted until the clean look is known."""

    def first_observation(self, clean: Images) -> Observation:
        """Paint the table, and look.

        Raises:
            NotDelivered: It cannot be seen, or no paint has a colour that far from its own.
        """
        own, black, white = _light(clean), self._plain("black", 0.0), self._plain("white", 1.0)
        self._table = ((white - black) > VISIBLE).all(axis=2)
        if self._table.mean() < LEAST_TABLE:
            raise NotDelivered(f"{self.episode.condition}: expected a table in the third-person image, found none")
        self._own = self._mean(own)
        dark, light = self._mean(black), self._mean(white)
        values = pattern(PATTERNS[self.episode.condition.severity - 1], self.generator)
        target = wanted = self._target(dark, light)
        for _ in range(self.corrections):
            self._paint(painted(np.clip((target - dark) / (light - dark), 0.0, 1.0), values))
            seen = self.simulation.observe()
            found = self._mean(_light(seen.images))
            self._distance = difference(found, self._own)
            if abs(self._distance - self.level) <= self.axis.tolerance / 2:
                break
            target = np.clip(light_of_lab(lab(target) + lab(wanted) - lab(found)), dark, light)
        return seen

    def measured(self, looks: ImagePairs) -> tuple[float, dict[str, float]]:
        """The distance of the mean colours of the table, and its share of the image."""
        return self.checked(self._distance), {"table": float(self._table.mean())}

    def _target(self, dark: FloatArray, light: FloatArray) -> FloatArray:
        """A colour, as seen, at the level's distance from the table's own, that some paint has."""
        own = lab(self._own)
        for _ in range(DRAWS):
            direction = self.generator.standard_normal(3)
            colour = light_of_lab(own + self.level * direction / np.linalg.norm(direction))
            if (colour >= dark + MARGIN).all() and (colour <= light - MARGIN).all():
                return colour
        raise NotDelivered(f"{self.episode.condition}: no paint is {self.level:g} from the table's own colour")

    def _paint(self, reflectance: FloatArray) -> None:
        self._stage.paint_table(np.rint(encoded(reflectance)).astype(np.uint8))

    def _plain(self, name: str, reflectance: float) -> FloatArray:
        """Linear light of the third-person image, the table painted in one grey."""

        def draw() -> Images:
            self._paint(np.full((1, 1, 3), reflectance))
            return self.simulation.observe().images

        return _light(self.references.get(self.episode.seed, f"{name} table", draw))

    def _mean(self, light: FloatArray) -> FloatArray:
        return np.asarray(light[self._table].mean(axis=0))


def _light(images: Images) -> FloatArray:
    """Linear light of the third-person image."""
    return linear(images[THIRD_PERSON])
