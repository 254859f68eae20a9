"""Moved cameras: orbit, distance, field of view, bumped mounts. Measured by what the simulator reads back."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from robogauntlet.adapters.camera_geometry import (
    aim_point,
    azimuth_between,
    bump,
    move_away,
    orbit,
    rotation_between,
    widen,
)
from robogauntlet.adapters.contract import Delivered, FloatArray, UnsupportedCondition
from robogauntlet.adapters.scene_control import Cameras, Viewpoint, unit
from robogauntlet.orchestrator.perturbations.base import Perturbed

THIRD_PERSON = "third_person"
BASE_HEIGHT = 0.0
"""What a third-person camera is aimed at lies at the height of the robot's base."""


class MovedCameras(Perturbed):
    """Some cameras with other viewpoints from the reset on."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then move the cameras.

        Raises:
            UnsupportedCondition: This simulation's cameras cannot be moved, or the policy is not shown the camera.
        """
        super().reset(seed)
        cameras: Cameras = self.offered(self.scene_controls.cameras, "cameras be moved")
        self._found: dict[str, tuple[Viewpoint, Viewpoint]] = {}
        for camera in self.moved():
            if camera not in self.observation_spec.cameras:
                raise UnsupportedCondition(f"{self.episode.condition}: expected a suite that shows camera '{camera}'")
            own = cameras.viewpoint(camera)
            cameras.set_viewpoint(camera, self.other(own))
            self._found[camera] = own, cameras.viewpoint(camera)

    def moved(self) -> Iterable[str]:
        """The cameras that are moved."""
        return (THIRD_PERSON,)

    def other(self, own: Viewpoint) -> Viewpoint:
        """A camera's other viewpoint."""
        raise NotImplementedError

    def measured(self, own: Viewpoint, other: Viewpoint) -> float:
        """How far a camera was moved, in the unit of the axis."""
        raise NotImplementedError

    def delivered(self) -> Delivered | None:
        """The mean over the cameras, each of which is held to the level."""
        values = [self.checked(self.measured(*found)) for found in self._found.values()]
        turned = {f"turned_{camera}": math.degrees(rotation_between(*found)) for camera, found in self._found.items()}
        return Delivered(float(np.mean(values)), turned)


class CameraOrbit(MovedCameras):
    """The third-person camera carried round what it is aimed at."""

    def other(self, own: Viewpoint) -> Viewpoint:
        """To the left or to the right, and a little upwards."""
        azimuth = math.radians(self.level) * self.generator.choice([-1.0, 1.0])
        return orbit(own, _aim(own), azimuth, math.radians(self.secondary_level))

    def measured(self, own: Viewpoint, other: Viewpoint) -> float:
        """The angle about the vertical (deg)."""
        return math.degrees(azimuth_between(_aim(own), own, other))


class CameraDistance(MovedCameras):
    """The third-person camera farther away."""

    def other(self, own: Viewpoint) -> Viewpoint:
        """Along its optical axis."""
        return move_away(own, _aim(own), self.level)

    def measured(self, own: Viewpoint, other: Viewpoint) -> float:
        """The ratio of the distances."""
        after, before = (np.linalg.norm(viewpoint.position - _aim(own)) for viewpoint in (other, own))
        return float(after / before)


class FieldOfView(MovedCameras):
    """The third-person camera with another lens."""

    def other(self, own: Viewpoint) -> Viewpoint:
        """A wider one."""
        return widen(own, math.radians(self.level))

    def measured(self, own: Viewpoint, other: Viewpoint) -> float:
        """The difference of the vertical fields of view (deg)."""
        return math.degrees(other.fovy - own.fovy)


class CameraBump(MovedCameras):
    """All cameras moved and turned at random, each on its own."""

    def moved(self) -> Iterable[str]:
        """All that the policy is shown."""
        return self.observation_spec.cameras

    def other(self, own: Viewpoint) -> Viewpoint:
        """By the level's length and angle, in directions drawn evenly over the sphere."""
        offset = self._direction() * self.level / 100
        return bump(own, offset, self._direction() * math.radians(self.secondary_level))

    def measured(self, own: Viewpoint, other: Viewpoint) -> float:
        """The length of the way (cm)."""
        return float(100 * np.linalg.norm(other.position - own.position))

    def _direction(self) -> FloatArray:
        return unit(self.generator.standard_normal(3))


def _aim(own: Viewpoint) -> FloatArray:
    return aim_point(own, BASE_HEIGHT)
