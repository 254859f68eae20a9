"""Adapters with one violation each in their cameras, see `tests.orchestrator.kit.adapter.variants`."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim.cameras import OWN_VIEWPOINTS, ToysimCameras
from tests.orchestrator.kit.adapter.variants import Variant


class Mirrored(Variant):
    def draw(self, camera, size):
        return super().draw(camera, size)[:, ::-1].copy()


class UpsideDown(Variant):
    def draw(self, camera, size):
        return super().draw(camera, size)[::-1].copy()


class WristTurnedRound(Variant):
    def draw(self, camera, size):
        image = super().draw(camera, size)
        return image[::-1, ::-1].copy() if camera == "wrist" else image


class UpsideDownWithoutControls(UpsideDown):
    """Offers no camera controls, so the cameras cannot be turned for the check."""

    def __init__(self, view):
        super().__init__(view)
        self.scene_controls = SceneControls()


class Rolled(ToysimCameras):
    """Mounted on the ceiling, with the correct viewpoint."""

    def viewpoint(self, camera):
        own = super().viewpoint(camera)
        return replace(own, rotation=own.rotation @ np.diag([-1.0, -1.0, 1.0]))


class Misplaced(ToysimCameras):
    def viewpoint(self, camera):
        own = super().viewpoint(camera)
        return replace(own, position=own.position + np.array([0.0, 0.5, 0.0]))


class Wide(ToysimCameras):
    def viewpoint(self, camera):
        own = super().viewpoint(camera)
        return replace(own, fovy=2.0 * own.fovy)

    def set_viewpoint(self, camera, viewpoint):
        super().set_viewpoint(camera, replace(viewpoint, fovy=0.5 * viewpoint.fovy))


class Deaf(ToysimCameras):
    def set_viewpoint(self, camera, viewpoint):
        pass


class _OtherCameras(Variant):
    cameras = ToysimCameras

    def __init__(self, view):
        super().__init__(view)
        self._cameras = self.cameras()
        self.scene_controls = SceneControls(cameras=self._cameras)


for _name, _other in {
    "CameraElsewhere": Misplaced,
    "HangsFromTheCeiling": Rolled,
    "HalfTheLens": Wide,
    "CameraStays": Deaf,
}.items():
    type(_name, (_OtherCameras,), {"cameras": _other})


class CameraKeepsItsPlace(_OtherCameras):
    def reset(self, seed):
        now = dict(self._cameras.now)
        super().reset(seed)
        self._cameras.now = now


class OffersNothing(Variant):
    def __init__(self, view):
        super().__init__(view)
        self.scene_controls = SceneControls()


class Culls(Variant):
    """Correct: leaves out balls that are wholly on the other side of a plane of the view."""

    culling, seen = True, 1.0

    def draw(self, camera, size):
        world, viewpoint = self._world, self.viewpoint(camera)
        carrier, origin = (world.turn, world.tool) if camera == "wrist" else (Rotation.identity(), np.zeros(3))
        eye, axes = origin + carrier.apply(viewpoint.position), carrier.as_matrix() @ viewpoint.rotation
        slope = np.tan(viewpoint.fovy / 2.0)
        inward = np.array([[1, 0, slope], [-1, 0, slope], [0, 1, slope], [0, -1, slope]]) / np.hypot(1.0, slope)

        def visible(ball):
            centre, radius, _ = ball
            return (inward @ axes.T @ (centre - eye) >= -self.seen * radius).all()

        every = world._balls
        world._balls = lambda: [ball for ball in every() if visible(ball) or not self.culling]
        try:
            return super().draw(camera, size)
        finally:
            del world._balls

    def viewpoint(self, camera):
        return self._cameras.now[camera]


class CullsByTheCentre(Culls):
    seen = 0.0


class CullsForItsOwnLens(Culls):
    """As if no camera had ever been given another lens."""

    def viewpoint(self, camera):
        return replace(super().viewpoint(camera), fovy=OWN_VIEWPOINTS[camera].fovy)
