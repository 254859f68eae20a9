"""Distractors on the table, and a table of another colour and pattern."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robogauntlet.adapters.contract import FloatArray, Observation, is_of_second_arm
from robogauntlet.adapters.photometry import difference, encoded, lab, light_of_lab, linear
from robogauntlet.adapters.scene_control import Form, Prop, Viewpoint
from robogauntlet.orchestrator.perturbations.base import ImagePairs, Images, PerturbedScene
from robogauntlet.orchestrator.perturbations.cameras import THIRD_PERSON

TASK_COLOURS = ((0.85, 0.1, 0.1), (0.1, 0.65, 0.15), (0.1, 0.2, 0.85))
"""Red, green and blue, like the tasks' own objects."""
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
CLEARANCE = 0.05
"""Smallest distance of a prop from the task's objects and the lines between them, all taken as round (m)."""
OBJECT_RADIUS = 0.03
"""Radius of a task's object (m)."""
DRAWS, MOST_DRAWS = 400, 8000
SHOWN = 0.9
"""Part of the third-person image, from its middle to its edges, in which props stand."""
VISIBLE = 0.25
"""Share of a prop's disc in the image that must show it."""
MIN_X = 0.2
"""Smallest distance of a prop from the robot's base, forwards (m)."""

MIN_CONTRAST = 0.1
"""Difference of linear light between white and black paint from which a pixel counts as the table's."""
MIN_TABLE = 0.1
"""Smallest share of the image that the table must fill."""
MARGIN = 0.005
"""Distance of a paint from black and white, in linear light."""
TEXELS = 64
"""Texels along each side of a pattern."""
SQUARES = 12
"""Squares along each side of a chequered pattern."""
BLOTCH = 2.5
"""Deviation of the blur that makes blotches of noise (texels)."""
CONTRAST = 0.7
"""Contrast of a pattern, as a share of the largest that its mean colour allows."""
PATTERNS = ("plain", "plain", "gradient", "chequered", "blotches")
"""The pattern at severity 1 to 5; between them, that of the nearest."""


class PerturbedTable(PerturbedScene):
    """A table that can be painted and have props on it."""

    def reset(self, seed: int) -> None:
        """Start the clean episode.

        Raises:
            UnsupportedCondition: This simulation's table cannot be changed.
        """
        super().reset(seed)
        self._control = self._required(self.scene_controls.table, "its table be changed")


class Distractors(PerturbedTable):
    """Props on the table that cannot be touched, each visible in the third-person image."""

    max_draws = 8
    """Number of draws after which hidden props are accepted, or refused by the tolerance."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then put props on the table."""
        super().reset(seed)
        self._cameras = self._required(self.scene_controls.cameras, "cameras be read")
        self._props = self._drawn_props([])
        self._show(perturbed=True)

    def _show(self, *, perturbed: bool) -> None:
        self._control.show(self._props if perturbed else ())

    def _first_observation(self, clean: Images) -> Observation:
        """Observe; hidden props, such as those behind the arm, are drawn again before."""
        for _ in range(self.max_draws):
            self._show(perturbed=True)
            observation = self.simulation.observe()
            self._visible = self._seen(clean, observation.images)
            if all(self._visible) or not self.must_show:
                break
            self._props = self._drawn_props(
                [prop for prop, seen in zip(self._props, self._visible, strict=True) if seen]
            )
        return observation

    def _measured(self, pairs: ImagePairs) -> tuple[float | None, dict[str, float]]:
        covered = {"covered": self._changed_share(pairs)}
        if THIRD_PERSON not in pairs:
            return None, covered
        return (self._checked if self.must_show else float)(sum(self._visible)), covered

    def _seen(self, clean: Images, images: Images) -> list[bool]:
        """Whether enough of the disc in which each prop appears differs from the clean third-person image.

        A pixel belongs to the nearest prop whose disc it is in.
        """
        if THIRD_PERSON not in images:
            return [True] * len(self._props)
        changed = (clean[THIRD_PERSON] != images[THIRD_PERSON]).any(axis=2)
        rows, columns = np.indices(changed.shape)
        discs = discs_of(self._cameras.viewpoint(THIRD_PERSON), self._props, len(changed))
        seen = [False] * len(self._props)
        for number in np.argsort(discs[:, 3]):
            column, row, radius, _ = discs[number]
            disc = (columns - column) ** 2 + (rows - row) ** 2 <= max(radius, 1.0) ** 2
            seen[number] = bool(changed[disc].sum() >= VISIBLE * math.pi * radius**2)
            changed[disc] = False
        return seen

    def _drawn_props(self, kept: Sequence[Prop]) -> list[Prop]:
        """These props, and others on the table in the third-person image; NotDelivered if it has no room for them."""
        state = self.simulation.privileged_state()
        objects = [
            where[:2] for name, where in state.items() if name.endswith("_position") and not is_of_second_arm(name)
        ]
        generator, (low, high), props = self.generator, self._control.table_edges, list(kept)
        own = [prop for prop in kept if prop.colour in TASK_COLOURS]
        for _ in range(MOST_DRAWS):
            if len(props) >= self.level:
                return props
            size, yaw = generator.uniform(*SIZES), generator.uniform(0.0, math.pi)
            radius = size / math.sqrt(2)
            form = list(Form)[generator.integers(len(Form))]
            place = point_on_plane(
                self._cameras.viewpoint(THIRD_PERSON), generator.uniform(-SHOWN, SHOWN, 2), self._control.table_height
            )
            if place is None or place[0] < MIN_X or not _is_free(place, radius, objects, props):
                continue
            if (place >= low + radius).all() and (place <= high - radius).all():
                colours = TASK_COLOURS if 2 * len(own) <= len(props) else OTHER_COLOURS
                colour = colours[generator.integers(len(colours))]
                props.append(Prop(form, np.array([*place, self._control.table_height + size / 2]), size, yaw, colour))
                own += props[-1:] if colours is TASK_COLOURS else []
        raise self._not_delivered(f"the table has no room for {self.level:g} props, only for {len(props)}")


def point_on_plane(viewpoint: Viewpoint, direction: FloatArray, height: float) -> FloatArray | None:
    """The point (2,) of a horizontal plane at a place (2,) in the image, from -1 (left, top) to 1; None in the sky."""
    ray = viewpoint.rotation @ np.append(direction * math.tan(viewpoint.fovy / 2), 1.0)
    if ray[2] >= 0.0:
        return None
    return np.asarray((viewpoint.position + ray * (height - viewpoint.position[2]) / ray[2])[:2])


def discs_of(viewpoint: Viewpoint, props: Sequence[Prop], pixels: int) -> FloatArray:
    """Column, row and radius (px) of n props in an image of that size, and their depths (m), shape (n, 4)."""
    right, down, forward = ((np.array([prop.position for prop in props]) - viewpoint.position) @ viewpoint.rotation).T
    scale = pixels / 2 / math.tan(viewpoint.fovy / 2) / forward
    middle, radii = (pixels - 1) / 2, np.array([prop.size / 2 for prop in props])
    return np.column_stack([middle + right * scale, middle + down * scale, radii * scale, forward])


def _is_free(place: FloatArray, radius: float, objects: list[FloatArray], props: list[Prop]) -> bool:
    """Whether a prop fits there. The lines between objects stay free, as tasks visit one after another."""
    lines = zip(objects, objects[1:] or objects, strict=False)
    if any(distance_to_segment(place, start, end) < CLEARANCE + radius + OBJECT_RADIUS for start, end in lines):
        return False
    return all(np.linalg.norm(place - p.position[:2]) >= radius + p.size / math.sqrt(2) + CLEARANCE / 2 for p in props)


def distance_to_segment(point: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Distance of a point (2,) from the line segment between two others."""
    way = end - start
    along = float(np.clip((point - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(point - start - along * way))


class Table(PerturbedTable):
    """A table of another colour, from severity 3 with a pattern.

    Images with black and with white paint show where the table is and how much of its light reaches the camera; they
    are rendered once per seed. The colour is chosen in the image, and corrected if the renderer delivers another.
    """

    max_paintings = 4
    """Number of paintings after which the colour is accepted, or refused by the tolerance."""

    def _first_observation(self, clean: Images) -> Observation:
        """Paint the table and observe; raises NotDelivered if it is not visible or no paint has such a colour."""
        own, black, white = _light(clean), self._plain("black", 0.0), self._plain("white", 1.0)
        self._table_pixels = ((white - black) > MIN_CONTRAST).all(axis=2)
        if self._table_pixels.mean() < MIN_TABLE:
            filled = 100 * self._table_pixels.mean()
            raise self._not_delivered(
                f"expected the table to fill {100 * MIN_TABLE:g} % of the image, got {filled:.1f} %"
            )
        self._own = self._mean(own)
        dark, light = self._mean(black), self._mean(white)
        values = pattern(PATTERNS[max(0, round(self.severity) - 1)], self.generator)
        target = wanted = self._target(dark, light)
        for _ in range(self.max_paintings):
            self._paint(painted(np.clip((target - dark) / (light - dark), 0.0, 1.0), values))
            observation = self.simulation.observe()
            colour = self._mean(_light(observation.images))
            self._distance = difference(colour, self._own)
            if abs(self._distance - self.level) <= self.axis.tolerance / 2:
                break
            target = np.clip(light_of_lab(lab(target) + lab(wanted) - lab(colour)), dark, light)
        return observation

    def _measured(self, pairs: ImagePairs) -> tuple[float, dict[str, float]]:
        return self._checked(self._distance), {"table": float(self._table_pixels.mean())}

    def _target(self, dark: FloatArray, light: FloatArray) -> FloatArray:
        """A colour in the image that some paint has, at the level's distance from the table's own."""
        own = lab(self._own)
        for _ in range(DRAWS):
            direction = self.generator.standard_normal(3)
            colour = light_of_lab(own + self.level * direction / np.linalg.norm(direction))
            if (colour >= dark + MARGIN).all() and (colour <= light - MARGIN).all():
                return colour
        raise self._not_delivered(f"no paint is {self.level:g} from the table's own colour")

    def _paint(self, reflectance: FloatArray) -> None:
        self._control.paint_table(np.rint(encoded(reflectance)).astype(np.uint8))

    def _plain(self, name: str, reflectance: float) -> FloatArray:
        """Linear light of the third-person image with the table in one grey."""

        def render() -> Images:
            self._paint(np.full((1, 1, 3), reflectance))
            return self.simulation.observe().images

        return _light(self.references.get(self.episode.seed, f"{name} table", render))

    def _mean(self, light: FloatArray) -> FloatArray:
        """The table's mean colour."""
        return np.asarray(light[self._table_pixels].mean(axis=0))


def _light(images: Images) -> FloatArray:
    """Linear light of the third-person image."""
    return linear(images[THIRD_PERSON])


def pattern(name: str, generator: np.random.Generator) -> FloatArray:
    """A pattern (TEXELS, TEXELS, 3) with values from -1 to 1 and mean 0 in each channel.

    Args:
        name: One of `PATTERNS`.
        generator: Draws the gradient's direction and the blotches.
    """
    rows, columns = np.indices((TEXELS, TEXELS))
    if name == "plain":
        values = np.zeros((TEXELS, TEXELS, 1))
    elif name == "gradient":
        angle = generator.uniform(0.0, 2 * math.pi)
        values = (rows * math.sin(angle) + columns * math.cos(angle))[..., None]
    elif name == "chequered":
        values = np.where((rows * SQUARES // TEXELS + columns * SQUARES // TEXELS) % 2, 1.0, -1.0)[..., None]
    else:
        from scipy.ndimage import gaussian_filter

        noise = generator.standard_normal((TEXELS, TEXELS, 3))
        values = np.sign(gaussian_filter(noise, (BLOTCH, BLOTCH, 0), mode="wrap"))
    values = values - values.mean(axis=(0, 1))
    return np.broadcast_to(values / max(1.0, float(np.abs(values).max())), (TEXELS, TEXELS, 3))


def painted(colour: FloatArray, values: FloatArray) -> FloatArray:
    """Reflectances (n, n, 3) from 0 to 1: a mean colour (3,) and a pattern of values from -1 to 1."""
    room = CONTRAST * np.minimum(colour, 1.0 - colour)
    return np.asarray(colour + room * values, dtype=np.float64)
