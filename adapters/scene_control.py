"""Optional controls of a simulation, with which perturbations change its scene.

Each control is a primitive: "an orbit of 20 degrees" or "one stop darker" is defined once for all simulators, in
`orchestrator.perturbations`. A change lasts until the next reset, which undoes it exactly. Values that are read back
come from the simulator, not from the request, so that they can be checked. Base frame, metres, radians.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Protocol

import numpy as np

from robogauntlet.adapters.contract import AdapterError, FloatArray, Image, Simulation


class Unreachable(AdapterError):
    """The arm cannot reach the pose without touching something."""


@dataclass(frozen=True)
class Viewpoint:
    """Pose and lens of a pinhole camera.

    The frame is the robot's base for the third-person camera, and the body that carries it for the wrist camera.
    """

    position: FloatArray
    """Shape (3,), m."""
    rotation: FloatArray
    """Shape (3, 3): the image's right, down and forward as columns."""
    fovy: float
    """Vertical field of view (rad)."""


class Cameras(Protocol):
    """Cameras that can be moved."""

    def viewpoint(self, camera: str) -> Viewpoint:
        """Return a camera's present viewpoint, from the simulator."""

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Set a camera's viewpoint. `picture` shows it too."""


@dataclass(frozen=True)
class Light:
    """The light of the scene."""

    gain: FloatArray
    """Shape (3,): factor of the linear light of red, green and blue of all lamps, relative to the task's own. Linear
    light is an image without its sRGB encoding: 0.5 is one stop darker in every renderer."""
    direction: FloatArray
    """Shape (3,), length 1: from the scene to the key light, the brightest lamp that has a direction."""


class Lights(Protocol):
    """Lamps that can be dimmed, coloured and moved."""

    def light(self) -> Light:
        """Return the present light, from the simulator."""

    def set_light(self, light: Light) -> None:
        """Set the light of the scene. `picture` shows it too."""


@dataclass(frozen=True)
class PlacementRegion:
    """The region in which resets place an object of the task."""

    low: FloatArray
    """Shape (2,), m: smallest x and y of its centre."""
    high: FloatArray
    """Shape (2,), m: largest x and y of its centre."""
    attached: tuple[str, ...] = ()
    """Names in `privileged_state` of the bodies that are mounted on it and move with it."""


class Objects(Protocol):
    """Objects of the task that can be moved."""

    def placeable(self) -> Mapping[str, PlacementRegion]:
        """Return the regions of the objects by their names in `privileged_state`, the main object of the task first.

        `<name>_position` is the centre that is moved. Resets fill the region almost uniformly.
        """

    def move(self, name: str, offset: FloatArray) -> None:
        """Move an object at rest by an offset (2,), x and y (m). Height and orientation stay."""


class Arm(Protocol):
    """An arm that can start in another pose."""

    def place_tool(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Bring the tool centre point, at rest, to a position (3,) and an orientation (4,) xyzw.

        The controller holds it there without a motion command. `privileged_state` shows the pose that was reached.

        Raises:
            Unreachable: The error would exceed 1 mm or 0.01 rad, or the arm would touch something. The arm has not
                moved.
        """


@dataclass(frozen=True)
class DynamicsFactors:
    """Factors relative to the task's own values."""

    mass: float = 1.0
    """Of the movable objects, inertia included."""
    friction: float = 1.0
    """Of the sliding friction of their contacts, which the simulator combines from the two bodies' coefficients."""


class BodyDynamics(Protocol):
    """Objects whose mass and friction can be set."""

    def dynamics(self) -> DynamicsFactors:
        """Return the present factors, from the simulator."""

    def set_dynamics(self, dynamics: DynamicsFactors) -> None:
        """Scale mass and friction of the task's objects."""


class Form(StrEnum):
    """A shape of a prop."""

    BOX = "box"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    """Upright."""


@dataclass(frozen=True)
class Prop:
    """An object that is visible and has no collisions."""

    form: Form
    position: FloatArray
    """Centre (3,), m."""
    size: float
    """Edge of the box, diameter of sphere or cylinder, and height of the cylinder (m)."""
    yaw: float
    """Rotation about the vertical (rad)."""
    colour: tuple[float, float, float]
    """Red, green, blue from 0 to 1, sRGB."""


class TableControl(Protocol):
    """A table that can be painted and can carry props."""

    table_height: float
    """Of the table's surface (m)."""

    @property
    def table_edges(self) -> FloatArray:
        """Smallest and largest x and y of the surface, shape (2, 2) (m)."""

    def show(self, props: Sequence[Prop]) -> None:
        """Show these props instead of the previous ones. They take no part in physics."""

    def shown(self) -> Sequence[FloatArray]:
        """Return the centres (3,) of the props, from the simulator (m)."""

    def paint_table(self, texture: Image) -> None:
        """Paint the table with a texture (n, n, 3), sRGB, stretched once over its surface.

        It is lit like the task's own surface, without gloss.
        """


class Starts(Protocol):
    """A task that starts in stored states and can start elsewhere."""

    def resample(self, seed: int) -> None:
        """Start anew where the task's own rules place things: equal seeds equally, none as a seed for training."""


@dataclass(frozen=True)
class SceneControls:
    """The controls of a simulation; None for those that it does not have."""

    cameras: Cameras | None = None
    lights: Lights | None = None
    objects: Objects | None = None
    arm: Arm | None = None
    dynamics: BodyDynamics | None = None
    table: TableControl | None = None
    starts: Starts | None = None

    def undo(self) -> None:
        """Restore the task's own scene, except what every reset sets anyway (controls without an `undo`)."""
        for field in fields(self):
            getattr(getattr(self, field.name), "undo", bool)()

    def offered(self) -> frozenset[str]:
        """Return the names of the controls that the simulation has."""
        return frozenset(field.name for field in fields(self) if getattr(self, field.name) is not None)


ADJUSTABLE = frozenset(field.name for field in fields(SceneControls))
"""Names of all controls."""


def scene_controls_of(simulation: Simulation) -> SceneControls:
    """Return the controls of a simulation, all None if it has no attribute `scene_controls`."""
    scene_controls: SceneControls = getattr(simulation, "scene_controls", SceneControls())
    return scene_controls


def unit(vector: FloatArray) -> FloatArray:
    """Return the vector, normalised to length 1."""
    return np.asarray(vector, dtype=np.float64) / np.linalg.norm(vector)
