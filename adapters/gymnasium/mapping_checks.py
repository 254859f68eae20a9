"""Applies a mapping file to its environment. Raises `ValueError` with one line if they do not fit."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from PIL import Image as Pillow
from PIL import ImageOps
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import ACTION_DIM, ACTION_NAMES, ActionSpec, FloatArray, Image, TaskUnavailable
from robogauntlet.adapters.frames import relative_pose
from robogauntlet.adapters.goals import goal_mistakes
from robogauntlet.adapters.gymnasium.mapping import EnvironmentMapping
from robogauntlet.suites.plugins import did_you_mean

SIZES = {"tcp_position": 3, "tcp_quaternion": 4, "finger_positions": 2}
"""Required entries of the state, and their numbers of values."""


def action_spec(mapping: EnvironmentMapping) -> ActionSpec:
    """Return the bounds of an action."""
    ignored = tuple(name for name in ACTION_NAMES if name not in mapping.action)
    return ActionSpec(mapping.max_translation, mapping.max_rotation, mapping.control_hz, ignored)


def action_map(mapping: EnvironmentMapping, space: Any) -> tuple[FloatArray, FloatArray]:
    """Return the matrix (n, 7) and offset (n,) that convert an action to that of the environment.

    Raises:
        ValueError: The environment's action lacks a number, or its bounds would be exceeded.
    """
    if len(getattr(space, "shape", None) or ()) != 1:
        raise ValueError(f"action: expected actions that are a row of numbers, {mapping.env} takes {space}")
    gain, offset = np.zeros((space.shape[0], ACTION_DIM)), np.zeros(space.shape[0])
    for name, drive in mapping.action.items():
        if drive.index >= len(gain):
            raise ValueError(f"action.{name}: expected an index below {len(gain)}, the size of {mapping.env}'s action")
        gain[drive.index, ACTION_NAMES.index(name)] = drive.scale
        offset[drive.index] += drive.offset
    reach = np.abs(gain) @ action_spec(mapping).high
    for number in np.flatnonzero((offset - reach < space.low - 1e-6) | (offset + reach > space.high + 1e-6)):
        reached = f"{offset[number] - reach[number]:g} to {offset[number] + reach[number]:g}"
        allowed = f"{space.low[number]:g} to {space.high[number]:g}"
        raise ValueError(
            f"action: number {number} would be {reached}, {mapping.env} takes {allowed}; lower scale or bounds"
        )
    return gain, offset


def make(mapping: EnvironmentMapping) -> Any:
    """Make the environment without a time limit.

    Raises:
        TaskUnavailable: A package is missing.
        ValueError: gymnasium cannot make the environment.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")
    import gymnasium

    rendered = {"render_mode": "rgb_array"} if "render" in (mapping.cameras.third_person, mapping.cameras.wrist) else {}
    try:
        return gymnasium.make(mapping.env, disable_env_checker=True, max_episode_steps=-1, **rendered | mapping.make)
    except ModuleNotFoundError as error:
        raise TaskUnavailable(f"{mapping.env}: {error}; install the package that provides it") from error
    except Exception as error:  # A constructor may raise anything.
        raise ValueError(f"env: gymnasium cannot make '{mapping.env}': {' '.join(str(error).split())}") from error


def is_mujoco(world: Any) -> bool:
    """Whether an environment without its wrappers gives access to MuJoCo's model and data."""
    return hasattr(world, "model") and hasattr(world, "data")


def in_base_frame(name: str, value: FloatArray, mapping: EnvironmentMapping) -> FloatArray:
    """Convert a value of the environment's world to the base frame, unless its name is that of another quantity.

    Poses are `*_position` (3,) and `*_quaternion`, a quaternion xyzw (4,) or a matrix, row by row, (9,).

    Raises:
        ValueError: A pose has another size.
    """
    sizes = {"position": (3,), "quaternion": (4, 9)}.get(name.rpartition("_")[2], (value.size,))
    if value.size not in sizes:
        raise ValueError(f"state.{name}: expected {' or '.join(map(str, sizes))} numbers, got {value.size}")
    base = np.array(mapping.base.position)
    turned = Rotation.from_euler("z", mapping.base.yaw, degrees=True).as_quat()
    if name.endswith("_position"):
        return relative_pose(base, turned, value, turned)[0]
    if not name.endswith("_quaternion"):
        return value
    rotation = Rotation.from_matrix(value.reshape(3, 3)) if value.size == 9 else Rotation.from_quat(value)
    if name == "tcp_quaternion":
        rotation *= Rotation.from_euler("XYZ", mapping.tool, degrees=True)
    return relative_pose(base, turned, base, rotation.as_quat())[1]


def check_camera(camera: str, mapping: EnvironmentMapping, world: Any) -> None:
    """Check that the environment can render a camera. Raises ValueError."""
    source = getattr(mapping.cameras, camera)
    if source is None:
        raise ValueError(f"no camera '{camera}' is mapped; add it to `cameras`, or let the suite do without it")
    if source == "render" and is_mujoco(world):
        raise ValueError(f"cameras.{camera}: {mapping.env} is of MuJoCo, name one of its cameras or an orbit")
    if source == "render":
        if "rgb_array" not in world.metadata.get("render_modes", ()):
            raise ValueError(f"cameras.{camera}: {mapping.env} cannot render to rgb_array")
    elif not is_mujoco(world):
        raise ValueError(f"cameras.{camera}: {mapping.env} is not of MuJoCo, only `render` can draw it")
    elif isinstance(source, str):
        known = [world.model.camera(number).name for number in range(world.model.ncam)]
        if source not in known:
            raise ValueError(f"cameras.{camera}: no camera '{source}' in the model{did_you_mean(source, known)}")


def scaled(image: Image, size: int) -> Image:
    """Return the middle of an image (height, width, 3), scaled to (size, size, 3)."""
    return np.array(ImageOps.fit(Pillow.fromarray(image), (size, size)))


def check_state(mapping: EnvironmentMapping, state: Mapping[str, FloatArray]) -> None:
    """Check the required entries of a state and their sizes, and that the goal fits them. Raises ValueError."""
    for name, size in SIZES.items():
        if name not in state:
            raise ValueError(f"state: missing key '{name}'")
        if state[name].size != size:
            raise ValueError(f"state.{name}: expected {size} numbers, got {state[name].size}")
    for field, expected, seen in goal_mistakes(mapping.goal.goal(), state) if mapping.goal else ():
        raise ValueError(f"goal.{field}: expected {expected}, found {seen}")
