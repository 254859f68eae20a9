"""Common parts of MuJoCo adapters: import, rendering, and the state that is hashed."""

from __future__ import annotations

import copy
import importlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from ctypes.util import find_library
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robogauntlet.adapters.contract import FloatArray, Image, SimulatorUnavailable
from robogauntlet.adapters.mujoco_culling import MujocoCulling
from robogauntlet.suites.episode import RenderProfile

_chosen: dict[str, str] = {}
"""The renderer with which mujoco was imported; robosuite overwrites the variable when it is imported."""


def import_mujoco() -> Any:
    """Import mujoco with a renderer: that of `MUJOCO_GL` if it is set, else EGL if installed, else OSMesa.

    Raises:
        SimulatorUnavailable: MuJoCo or its renderer is missing.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")
    if os.environ["MUJOCO_GL"] == "egl" and find_library("EGL") is None and "mujoco" not in sys.modules:
        os.environ["MUJOCO_GL"] = "osmesa"
    _chosen.setdefault("MUJOCO_GL", os.environ["MUJOCO_GL"])
    try:
        return importlib.import_module("mujoco")
    except ModuleNotFoundError as error:
        raise SimulatorUnavailable(f"{error}; install it: pip install mujoco") from error
    except Exception as error:  # MuJoCo opens its display on import; the GL bindings raise exceptions of any type.
        raise no_rendering(error) from error


def no_rendering(error: Exception) -> SimulatorUnavailable:
    """Return the error to raise when MuJoCo cannot render, with what to do about it."""
    renderer = _chosen.get("MUJOCO_GL", os.environ.get("MUJOCO_GL", ""))
    visible, device = (os.environ.get(name, "") for name in ("CUDA_VISIBLE_DEVICES", "MUJOCO_EGL_DEVICE_ID"))
    if renderer not in ("egl", "osmesa"):
        remedy = "unset MUJOCO_GL, which is then egl and needs no screen, or set MUJOCO_GL=osmesa"
    elif device and visible and device not in visible.split(","):
        remedy = f"MUJOCO_EGL_DEVICE_ID={device} is not among CUDA_VISIBLE_DEVICES={visible}; "
        remedy += "set it to one of them, or unset it"
    elif device and renderer == "egl":
        remedy = f"unset MUJOCO_EGL_DEVICE_ID={device}, or set it to the number of a device that EGL has"
    else:
        remedy = (
            "install the Debian packages libegl1, libegl-mesa0 and libgl1-mesa-dri, or install libosmesa6 and set "
            "MUJOCO_GL=osmesa before mujoco is first imported"
        )
    said = " ".join(str(error).split()).rstrip(".")
    return SimulatorUnavailable(f"MuJoCo cannot render with MUJOCO_GL={renderer} ({said}): {remedy}")


class MujocoScene:
    """Renders a MuJoCo model and its data. `fast` and `fast-2` omit shadows, reflections and multisampling."""

    def __init__(self, model: Any, data: Any, profile: RenderProfile, option: Any = None) -> None:
        """Take the model and its data, whose poses must be up to date before rendering.

        `option` is MuJoCo's `MjvOption`, which selects groups of shapes; by default all are rendered as usual.
        """
        self._mujoco = import_mujoco()
        self._model, self._data, self._fast = model, data, profile is not RenderProfile.STANDARD
        self._option = option or self._mujoco.MjvOption()
        self._culling = MujocoCulling(self._mujoco, model)
        self.renderers: dict[int, Any] = {}
        """Image size to MuJoCo's renderer, created at first use."""

    def image(
        self,
        camera: Any,
        size: int,
        add: Callable[[Any], None] | None = None,
        data: Any = None,
        *,
        culling: bool = True,
    ) -> Image:
        """Render a new upright RGB image, shape (size, size, 3), of a camera by name or an `MjvCamera`.

        `add` adds shapes to the `MjvScene` before it is rendered; `data` replaces the data of the constructor. With
        `culling`, shapes outside the view are left out, which changes no pixel.

        Raises:
            SimulatorUnavailable: This machine cannot render.
        """
        renderer, data = self.renderers.get(size) or self._create_renderer(size), data or self._data
        if isinstance(camera, str):
            name, camera = camera, self._mujoco.MjvCamera()
            camera.type, camera.fixedcamid = self._mujoco.mjtCamera.mjCAMERA_FIXED, self._model.camera(name).id
        self._mujoco.mjv_updateCamera(self._model, data, camera, renderer.scene)
        with self._left_out(self._culling.outside(data, renderer.scene)) if culling else nullcontext():
            renderer.update_scene(data, camera, self._option)
        if add:
            add(renderer.scene)
        image: Image = renderer.render()
        return image

    @contextmanager
    def _left_out(self, shapes: Any) -> Iterator[None]:
        """Put shapes, by a mask (n,), into a group that is not rendered, if there is one."""
        groups, unseen = self._model.geom_group.copy(), np.flatnonzero(self._option.geomgroup == 0)
        if len(unseen):
            self._model.geom_group[shapes] = unseen[0]
        try:
            yield
        finally:
            self._model.geom_group[:] = groups

    def _create_renderer(self, size: int) -> Any:
        mujoco, visual = self._mujoco, self._model.vis
        visual.global_.offwidth = visual.global_.offheight = size  # A larger off-screen buffer takes longer to clear.
        if self._fast:
            visual.quality.offsamples = 0
        try:
            renderer = mujoco.Renderer(self._model, height=size, width=size)
        except Exception as error:  # The exceptions of MuJoCo and the GL bindings have no common base.
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


def engine_time(model: Any, data: Any, steps: int) -> float:
    """Return the CPU time of MuJoCo's own physics steps (s), taken on a copy of the data with the present controls."""
    mujoco, copied = import_mujoco(), copy.copy(data)
    start = time.process_time()
    mujoco.mj_step(model, copied, steps)
    return time.process_time() - start


def drawing_device() -> str:
    """Return OpenGL's name of the present renderer."""
    gl = importlib.import_module("OpenGL.GL")
    name: bytes = gl.glGetString(gl.GL_RENDERER)
    return name.decode()


def orbit_camera(at: ArrayLike, distance: float, azimuth: float, elevation: float) -> Any:
    """Return MuJoCo's free camera, for `MujocoScene.image`.

    Args:
        at: Point in the centre of the image (3,), m, the model's world.
        distance: Distance from that point (m).
        azimuth: Viewing direction about the vertical (degrees); 0 is along the world's x.
        elevation: Viewing direction upwards (degrees); -90 is straight down.
    """
    camera = import_mujoco().MjvCamera()
    camera.lookat, camera.distance, camera.azimuth, camera.elevation = at, distance, azimuth, elevation
    return camera


def mujoco_state(model: Any, data: Any) -> dict[str, FloatArray]:
    """Return the state of a MuJoCo simulation, for `robogauntlet.adapters.frames.hash_state`.

    Joints, actuators, mocap bodies, and the poses of fixed bodies, which tasks move from episode to episode.
    """
    moving = {name: getattr(data, name) for name in ("qpos", "qvel", "act", "mocap_pos", "mocap_quat")}
    return moving | {name: getattr(model, name) for name in ("body_pos", "body_quat")}
