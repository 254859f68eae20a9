"""Moved cameras: orbit, distance, field of view, bumped mounts. Measured by what the simulator reads back."""

from __future__ import annotations

import math

import numpy as np

from robogauntlet.adapters import camera_geometry as geometry
from robogauntlet.adapters.contract import Delivered, FloatArray, UnsupportedCondition
from robogauntlet.adapters.scene_control import Viewpoint, unit
from robogauntlet.orchestrator.perturbations.base import Perturbed

THIRD_PERSON = "third_person"
BASE_HEIGHT = 0.0
"""Height of the robot's base (m). A third-person camera is aimed at a point of this height."""


class MovedCameras(Perturbed):
    """Cameras with another viewpoint from the reset on."""

    moves_all = False
    """Whether all cameras of the policy are moved, not only the third-person camera."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then move the cameras.

        Raises:
            UnsupportedCondition: This simulation's cameras cannot be moved, or the policy does not see the camera.
        """
        super().reset(seed)
        cameras = self._required(self.scene_controls.cameras, "cameras be moved")
        self._viewpoints: dict[str, tuple[Viewpoint, Viewpoint]] = {}
        """Camera to its viewpoint before and after."""
        visible = self.observation_spec.cameras
        for camera in visible if self.moves_all else (THIRD_PERSON,):
            if camera not in visible:
                raise UnsupportedCondition(f"{self.episode.condition}: expected a suite that shows camera '{camera}'")
            own = cameras.viewpoint(camera)
            cameras.set_viewpoint(camera, self._moved(own))
            self._viewpoints[camera] = own, cameras.viewpoint(camera)

    def delivered(self) -> Delivered:
        """The mean over the cameras, each of which must deliver the level."""
        values = [self._checked(self._measured(own, other)) for own, other in self._viewpoints.values()]
        turned = {
            f"turned_{camera}": math.degrees(geometry.rotation_between(own, other))
            for camera, (own, other) in self._viewpoints.items()
        }
        return Delivered(float(np.mean(values)), turned)

    def _moved(self, own: Viewpoint) -> Viewpoint:
        raise NotImplementedError

    def _measured(self, own: Viewpoint, other: Viewpoint) -> float:
        """The difference of the viewpoints in the unit of the axis."""
        raise NotImplementedError


class CameraOrbit(MovedCameras):
    """The third-person camera turned about its aim point, to the left or right and a little upwards."""

    def _moved(self, own: Viewpoint) -> Viewpoint:
        azimuth = math.radians(self.level) * self.generator.choice([-1.0, 1.0])
        return geometry.orbit(own, _aim(own), azimuth, math.radians(self.secondary_level))

    def _measured(self, own: Viewpoint, other: Viewpoint) -> float:
        return math.degrees(geometry.azimuth_between(_aim(own), own, other))


class CameraDistance(MovedCameras):
    """The third-person camera moved back along its optical axis; measured by the ratio of the distances."""

    def _moved(self, own: Viewpoint) -> Viewpoint:
        return geometry.move_away(own, _aim(own), self.level)

    def _measured(self, own: Viewpoint, other: Viewpoint) -> float:
        after, before = (np.linalg.norm(viewpoint.position - _aim(own)) for viewpoint in (other, own))
        return float(after / before)


class FieldOfView(MovedCameras):
    """The third-person camera with a wider lens; measured by the vertical fields of view (deg)."""

    def _moved(self, own: Viewpoint) -> Viewpoint:
        return geometry.widen(own, math.radians(self.level))

    def _measured(self, own: Viewpoint, other: Viewpoint) -> float:
        return math.degrees(other.fovy - own.fovy)


class CameraBump(MovedCameras):
    """All cameras moved and turned in directions drawn uniformly on the sphere; measured by the translation (cm)."""

    moves_all = True

    def _moved(self, own: Viewpoint) -> Viewpoint:
        offset = self._direction() * self.level / 100
        return geometry.bump(own, offset, self._direction() * math.radians(self.secondary_level))

    def _measured(self, own: Viewpoint, other: Viewpoint) -> float:
        return float(100 * np.linalg.norm(other.position - own.position))

    def _direction(self) -> FloatArray:
        return unit(self.generator.standard_normal(3))


def _aim(own: Viewpoint) -> FloatArray:
    return geometry.aim_point(own, BASE_HEIGHT)
