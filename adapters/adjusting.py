"""What a simulation may offer beside the contract, so that perturbations of its world can be played in it.

Each is a primitive, not a perturbation: what "an orbit of 20 degrees" or "one stop darker" means is written once, in
`orchestrator.perturbations`, on top of them. Every change lasts until the next reset, which undoes it to the bit. What
is read back comes from the simulator, not from what was asked for, so that it can be checked. Base frame, metres,
radians.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np

from adapters.contract import AdapterError, FloatArray, Image


class Unreachable(AdapterError):
    """The arm cannot be brought there without touching something."""


@dataclass(frozen=True)
class Viewpoint:
    """Where a pinhole camera is and how it looks, in the frame of its carrier.

    The third-person camera's is the robot's base, the wrist camera's the body that it is mounted on.
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
        """A camera's viewpoint as the simulator has it now."""

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Give a camera another viewpoint. `picture` shows it too."""


@dataclass(frozen=True)
class Light:
    """How the scene is lit."""

    gain: FloatArray
    """Shape (3,): factor of the linear light of red, green and blue, of all lamps alike, against the task's own. Linear
    light is what an image is once its sRGB encoding is undone: 0.5 is one stop darker, whatever the renderer's knobs
    mean."""
    direction: FloatArray
    """Shape (3,), length 1: from the scene to the key light, the brightest lamp that has a direction."""


class Lights(Protocol):
    """Lamps that can be dimmed, coloured and moved."""

    def light(self) -> Light:
        """The light as the simulator has it now."""

    def set_light(self, light: Light) -> None:
        """Give the scene another light. `picture` shows it too."""


@dataclass(frozen=True)
class Placeable:
    """A thing of the task that can be put elsewhere."""

    low: FloatArray
    """Shape (2,), m: the task's resets put its centre at x, y of no less than this."""
    high: FloatArray
    """Shape (2,), m: and of no more than this."""


class Objects(Protocol):
    """The task's things, which can be put elsewhere."""

    def placeable(self) -> Mapping[str, Placeable]:
        """What can be moved, the thing that the task is about first; named as in `privileged_state`.

        `<name>_position` is the centre that is moved. Resets fill the box evenly, or almost so.
        """

    def move(self, name: str, offset: FloatArray) -> None:
        """Move a thing by an offset (2,), x and y; height and orientation stay, and so does its rest."""


class Arm(Protocol):
    """An arm that can start elsewhere."""

    turns: bool
    """Whether the tool can be turned; if not, a rotation is refused."""

    def place_tool(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Bring the arm, at rest, to where its tool centre point is at a position (3,) with an orientation (4,) xyzw.

        The controller holds it there when told to stay. `privileged_state` says how well it was met.

        Raises:
            Unreachable: It cannot be met to within 1 mm and 0.01 rad, or something would be touched. The arm is where
                it was.
        """


@dataclass(frozen=True)
class Dynamics:
    """Factors against the task's own."""

    mass: float = 1.0
    """Of the things that can be moved, inertia included."""
    friction: float = 1.0
    """Of these things' own coefficient of sliding friction; what a contact makes of two coefficients is the simulator's
    affair."""


class Bodies(Protocol):
    """Things whose mass and friction can be set."""

    def dynamics(self) -> Dynamics:
        """The factors, from what the simulator has now."""

    def set_dynamics(self, dynamics: Dynamics) -> None:
        """Give the task's things other masses and frictions."""


class Form(StrEnum):
    """A shape to be drawn."""

    BOX = "box"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    """Upright."""


@dataclass(frozen=True)
class Prop:
    """Something that is seen and cannot be touched."""

    form: Form
    position: FloatArray
    """Centre (3,), m."""
    size: float
    """Edge of the box, diameter of sphere or cylinder, and height of the cylinder (m)."""
    yaw: float
    """Turned about the vertical (rad)."""
    colour: tuple[float, float, float]
    """Red, green, blue from 0 to 1, sRGB."""


class Stage(Protocol):
    """A table with a surface, and room for props on it."""

    table_height: float
    """Of the table's surface (m)."""

    def show(self, props: Sequence[Prop]) -> None:
        """Draw props beside the task's own things, in place of those before. Physics does not know them."""

    def shown(self) -> Sequence[FloatArray]:
        """Where the props are now, centres (3,), as the simulator has them."""

    def paint_table(self, texture: Image) -> None:
        """Draw the table's surface with a texture (n, n, 3), sRGB, stretched once over it.

        Light falls on it as on the task's own, but nothing shines or has grain.
        """


@dataclass(frozen=True)
class Adjusters:
    """What of a simulation's world can be adjusted; None where it cannot."""

    cameras: Cameras | None = None
    lights: Lights | None = None
    objects: Objects | None = None
    arm: Arm | None = None
    bodies: Bodies | None = None
    stage: Stage | None = None

    def offered(self) -> frozenset[str]:
        """The names of those that are there."""
        return frozenset(field.name for field in fields(self) if getattr(self, field.name) is not None)


ADJUSTABLE = frozenset(field.name for field in fields(Adjusters))
"""What of a world there is to be adjusted."""


@runtime_checkable
class Adjustable(Protocol):
    """A simulation of whose world something can be adjusted."""

    adjusters: Adjusters


def unit(vector: FloatArray) -> FloatArray:
    """The vector, at length 1."""
    return np.asarray(vector, dtype=np.float64) / np.linalg.norm(vector)
