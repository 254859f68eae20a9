"""What adapters of MuJoCo simulators share: the import, drawing, and the state that a hash is made of."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from ctypes.util import find_library
from typing import Any

from numpy.typing import ArrayLike

from adapters.contract import FloatArray, Image, SimulatorUnavailable
from suites.vocabulary import RenderProfile


def import_mujoco() -> Any:
    """The module mujoco, with a way to render chosen: `MUJOCO_GL` if it is set, else EGL if it is there, else OSMesa.

    Raises:
        SimulatorUnavailable: MuJoCo is missing, or what it is to render with.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")
    if os.environ["MUJOCO_GL"] == "egl" and find_library("EGL") is None and "mujoco" not in sys.modules:
        os.environ["MUJOCO_GL"] = "osmesa"
    try:
        return importlib.import_module("mujoco")
    except ModuleNotFoundError as error:
        raise SimulatorUnavailable(f"{error}: pip install mujoco") from error
    except Exception as error:  # MuJoCo opens its display on import; the GL bindings raise what they like.
        raise no_rendering(error) from error


def no_rendering(error: Exception) -> SimulatorUnavailable:
    """The error to raise when MuJoCo cannot draw."""
    return SimulatorUnavailable(
        f"MuJoCo cannot render with MUJOCO_GL={os.environ['MUJOCO_GL']} ({error}): install Mesa's libEGL, or libOSMesa "
        "with MUJOCO_GL=osmesa; it must be set before mujoco is first imported"
    )


class MujocoScene:
    """Draws a MuJoCo model as its data are now. `fast` draws no shadows, reflections and multisampling."""

    def __init__(self, model: Any, data: Any, profile: RenderProfile, option: Any = None) -> None:
        """Take what is drawn.

        Args:
            model: MuJoCo's.
            data: MuJoCo's, with poses up to date whenever something is drawn.
            profile: How much is drawn.
            option: MuJoCo's `MjvOption`: which groups of shapes are drawn; its default if None.
        """
        self._mujoco = import_mujoco()
        self._model, self._data, self._fast = model, data, profile is RenderProfile.FAST
        self._option = option or self._mujoco.MjvOption()
        self.renderers: dict[int, Any] = {}
        """Image size to MuJoCo's renderer, made on first use."""

    def image(self, camera: Any, size: int, add: Callable[[Any], None] | None = None, data: Any = None) -> Image:
        """An upright RGB image, shape (size, size, 3), of its own.

        Args:
            camera: Name of a camera of the model, or an `MjvCamera`.
            size: Height and width (px).
            add: Puts further shapes into the `MjvScene` that is about to be drawn.
            data: Drawn instead of those given at the beginning.

        Raises:
            SimulatorUnavailable: Nothing here can render.
        """
        renderer = self.renderers.get(size) or self._made(size)
        renderer.update_scene(data or self._data, camera, self._option)
        if add:
            add(renderer.scene)
        image: Image = renderer.render()
        return image

    def _made(self, size: int) -> Any:
        mujoco, visual = self._mujoco, self._model.vis
        visual.global_.offwidth = max(visual.global_.offwidth, size)
        visual.global_.offheight = max(visual.global_.offheight, size)
        if self._fast:
            visual.quality.offsamples = 0
        try:
            renderer = mujoco.Renderer(self._model, height=size, width=size)
        except Exception as error:  # What MuJoCo and the GL bindings raise here has no common base.
            raise no_rendering(error) from error
        if self._fast:
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self.renderers[size] = renderer
        return renderer

    def close(self) -> None:
        """Free the renderers. Safe to call twice."""
        while self.renderers:
            self.renderers.popitem()[1].close()


def drawing_device() -> str:
    """OpenGL's name of what drew last."""
    gl = importlib.import_module("OpenGL.GL")
    name: bytes = gl.glGetString(gl.GL_RENDERER)
    return name.decode()


def orbit_camera(at: ArrayLike, distance: float, azimuth: float, elevation: float) -> Any:
    """MuJoCo's free camera, for `MujocoScene.image`.

    Args:
        at: The point in the middle of the image (3,), m, the model's world.
        distance: From there (m).
        azimuth: Where it looks, about the vertical (degrees); 0 is along the world's x.
        elevation: And how far upwards (degrees); -90 is straight down.
    """
    camera = import_mujoco().MjvCamera()
    camera.lookat, camera.distance, camera.azimuth, camera.elevation = at, distance, azimuth, elevation
    return camera


def mujoco_state(model: Any, data: Any) -> dict[str, FloatArray]:
    """What decides how a MuJoCo world goes on, for `adapters.frames.hash_state`.

    Joints, actuators, mocap bodies, and where fixed bodies were put: tasks move those from episode to episode.
    """
    moving = {name: getattr(data, name) for name in ("qpos", "qvel", "act", "mocap_pos", "mocap_quat")}
    return moving | {name: getattr(model, name) for name in ("body_pos", "body_quat")}
