"""Observations and action chunks in the convention of an external policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from robogauntlet.adapters.contract import ACTION_DIM, FloatArray, Image, Moves, Observation
from robogauntlet.policies.contract import PolicyMismatch, Query
from robogauntlet.policies.remote import libero
from robogauntlet.policies.remote.server_options import Convention
from robogauntlet.suites.episode import Episode
from robogauntlet.support.text import visible

MAX_ACTIONS = 1000
"""Longest chunk that is accepted in an answer."""


@runtime_checkable
class EncodesImages(Protocol):
    """A policy that turns or resizes images before its network gets them."""

    def images_sent(self, query: Query) -> Mapping[str, Image]:
        """Return the images of a query as they are sent, by the names under which they are sent."""


def images_in(message: Mapping[str, Any]) -> dict[str, Image]:
    """Return the images of a message, which `encode_observation` has made."""
    return {
        key: value
        for key, value in message.items()
        if isinstance(value, np.ndarray) and value.ndim == 3 and value.dtype == np.uint8
    }


def encode_observation(convention: Convention, observation: Observation, episode: Episode) -> dict[str, Any]:
    """Return an observation in an episode under the server's keys. PolicyMismatch if the convention lacks the task."""
    message: dict[str, Any] = encode_images(convention, observation, episode)
    message |= encode_proprioception(convention, observation, episode)
    if convention.instruction is not None:
        message[convention.instruction] = observation.instruction
    return message


def encode_images(convention: Convention, observation: Observation, episode: Episode) -> dict[str, Image]:
    """Return an observation's images, (height, width, 3), under the server's keys."""
    # The protocol has mirrored images already, as LIBERO's policies expect them.
    mirrored = convention.convention == "libero" and episode.protocol.mirrored
    return {
        key: resize_image(convention, turn_image(convention, camera, observation.images[camera], mirrored=mirrored))
        for camera, key in convention.cameras.items()
    }


def encode_proprioception(convention: Convention, observation: Observation, episode: Episode) -> dict[str, FloatArray]:
    """Return an observation's proprioception, (n,) under each of the server's keys; none if it is left out.

    Raises PolicyMismatch if the convention lacks the task, or a column is beyond its numbers.
    """
    keys, state = convention.proprioception_keys, observation.proprioception
    if keys is None:
        return {}
    _check_kind(convention, observation, episode.task)
    if convention.joints:
        state = np.concatenate([_native_joints(convention, arm) for arm in np.split(state, convention.arms)])
    elif convention.convention == "libero":
        state = libero.native_proprioception(episode.task, state, observation.hand_quaternion)
    if beyond := [column for columns in keys.values() for column in columns or () if column >= len(state)]:
        raise PolicyMismatch(f"option proprioception: expected columns below {len(state)}, got {beyond[0]}")
    return {key: state if columns is None else state[list(columns)] for key, columns in keys.items()}


def _check_kind(convention: Convention, observation: Observation, task: str) -> None:
    numbers = f"{len(observation.proprioception)} numbers of joints"
    shown = numbers if observation.of_joints else str(Moves.TOOL if observation.native is None else Moves.NATIVE)
    wanted = f"{convention.width} numbers of joints" if convention.joints else str(convention.moves)
    if wanted != shown:
        raise PolicyMismatch(
            f"expected a task with {wanted}, {task} has {shown}; see options convention, joints and arms"
        )


def _native_joints(convention: Convention, state: FloatArray) -> FloatArray:
    """Return the angles of an arm's joints and its gripper's number (n + 1,) in the units of the convention."""
    closed = (state[-1] + 1.0) / 2.0
    gripper = convention.gripper_open + closed * (convention.gripper_closed - convention.gripper_open)
    return np.append(state[:-1] / np.asarray(convention.joint_scale), gripper)


def turn_image(convention: Convention, camera: str, image: Image, *, mirrored: bool = False) -> Image:
    """Turn or mirror a camera's image (height, width, 3), which may be mirrored already."""
    rows, columns = convention.turn_of(camera)
    return np.ascontiguousarray(image[::rows, :: -columns if mirrored else columns])


def resize_image(convention: Convention, image: Image) -> Image:
    """Resize an image, bilinear; black padding on both sides fills another shape, or it is cut to that shape."""
    if convention.image_size is None:
        return image
    height, width = convention.image_size if isinstance(convention.image_size, tuple) else (convention.image_size,) * 2
    if image.shape[:2] == (height, width):
        return image
    from PIL import Image as Picture, ImageOps

    picture = Picture.fromarray(image)
    if convention.resize == "crop":
        return np.asarray(ImageOps.fit(picture, (width, height), Picture.Resampling.BILINEAR))
    if convention.resize == "stretch":
        return np.asarray(picture.resize((width, height), Picture.Resampling.BILINEAR))
    factor = min(width / picture.width, height / picture.height)
    inner = max(1, int(picture.width * factor)), max(1, int(picture.height * factor))
    padded = Picture.new("RGB", (width, height))
    padded.paste(
        picture.resize(inner, Picture.Resampling.BILINEAR), ((width - inner[0]) // 2, (height - inner[1]) // 2)
    )
    return np.asarray(padded)


def decode_chunk(convention: Convention, answer: Mapping[str, Any], numbers: int = ACTION_DIM) -> FloatArray:
    """Return an answer's chunk, shape (n, numbers of an action), in the units of `robogauntlet.adapters.contract`.

    Raises PolicyMismatch if the chunk is missing, too short or too narrow, or not finite.
    """
    columns = convention.columns or tuple(range(numbers if convention.is_native else convention.width))
    width = 1 + max((column for column in columns if column is not None), default=0)
    rows = read_chunk(answer, convention.actions, width, exactly=convention.columns is None)
    if convention.execute is not None:
        if len(rows) < convention.execute:
            raise PolicyMismatch(f"option execute: expected {convention.execute} actions or more, got {len(rows)}")
        rows = rows[: convention.execute]
    read = np.stack([np.zeros(len(rows)) if column is None else rows[:, column] for column in columns], axis=1)
    if convention.is_native:
        return read
    each, given = np.split(read, convention.arms, axis=1), np.split(np.array(columns, dtype=object), convention.arms)
    arms = []
    for arm, own in zip(each, given, strict=True):
        gripper = arm[:, -1:] if own[-1] is None else _grippers(convention, arm[:, -1:])
        arms.append(np.concatenate([_moved(convention, arm[:, :-1]), gripper], axis=1))
    return np.concatenate(arms, axis=1)


def _moved(convention: Convention, read: FloatArray) -> FloatArray:
    """Return the numbers of an arm before its gripper's (n, numbers) in the contract's units."""
    if convention.joints:
        return read * np.asarray(convention.velocity_scale or convention.joint_scale)
    return np.concatenate([read[:, :3] * convention.translation_scale, as_axis_angles(convention, read[:, 3:])], axis=1)


def _grippers(convention: Convention, read: FloatArray) -> FloatArray:
    span = convention.gripper_closed - convention.gripper_open
    if convention.gripper_threshold is not None:
        return np.where((read - convention.gripper_threshold) * span > 0, 1.0, -1.0)
    if (convention.gripper_open, convention.gripper_closed) == (-1.0, 1.0):
        return read  # already in the contract's units, so nothing is rounded
    return 2.0 * (read - convention.gripper_open) / span - 1.0


def as_axis_angles(convention: Convention, rotations: FloatArray) -> FloatArray:
    """Convert an answer's rotations, (n, 3) or (n, 4), to axis-angle vectors (n, 3), rad, of angles up to pi.

    Raises PolicyMismatch for a quaternion whose length differs from 1 by more than 0.01, which float16 never does.
    """
    if convention.rotation == "axis-angle":
        return rotations * convention.rotation_scale
    from scipy.spatial.transform import Rotation  # takes 0.2 s, in commands that ask no server

    if convention.rotation == "euler":
        return Rotation.from_euler("xyz", rotations * convention.rotation_scale).as_rotvec()
    lengths = np.linalg.norm(rotations, axis=1)
    for row in np.flatnonzero(np.abs(lengths - 1.0) > 0.01):
        raise PolicyMismatch(
            f"expected quaternions of length 1 in '{convention.actions}', got length {lengths[row]:.3g} in row {row}; "
            "see options rotation and columns"
        )
    return Rotation.from_quat(rotations, scalar_first=convention.rotation.endswith("wxyz")).as_rotvec()


def read_chunk(answer: Mapping[str, Any], keys: str | Sequence[str], width: int, *, exactly: bool) -> FloatArray:
    """Return the finite array (n, width or more) under a key of an answer, or under several, side by side, float64.

    Raises PolicyMismatch for anything else.
    """
    parts = {key: _numbers(answer, key) for key in ([keys] if isinstance(keys, str) else keys)}
    key, rows = ", ".join(parts), next(iter(parts.values()))
    if len(parts) > 1:
        if {(part.ndim, part.shape[:1]) for part in parts.values()} != {(2, rows.shape[:1])}:
            shapes = ", ".join(f"{name} {part.shape}" for name, part in parts.items())
            raise PolicyMismatch(f"expected chunks of shape (n, columns) with one n, got {shapes[:200]}")
        rows = np.concatenate([*parts.values()], axis=1)
    fits = rows.ndim == 2 and (rows.shape[1] == width if exactly else rows.shape[1] >= width)
    if not fits or not 1 <= len(rows) <= MAX_ACTIONS:
        wanted = f"{width}" if exactly else f"{width} or more"
        hint = "; choose the action's columns by option columns" if rows.ndim == 2 and exactly else ""
        raise PolicyMismatch(
            f"expected '{key}' of shape (n, {wanted}), n from 1 to {MAX_ACTIONS}, got {rows.shape}{hint}"
        )
    rows = rows.astype(np.float64)
    if not np.isfinite(rows).all():
        row, column = np.argwhere(~np.isfinite(rows))[0]
        raise PolicyMismatch(
            f"expected finite numbers as '{key}', got {rows[row, column]} in row {row}, column {column}"
        )
    return rows


def _numbers(answer: Mapping[str, Any], key: str) -> np.ndarray:
    if key not in answer:
        keys = visible(", ".join(sorted(map(str, answer)))[:200]) or "nothing"
        raise PolicyMismatch(f"expected '{key}' in the answer, got {keys}; set option actions")
    try:
        numbers = np.asarray(answer[key])
    except ValueError:
        numbers = np.empty(0, dtype=object)
    if numbers.dtype.kind not in "iuf":
        raise PolicyMismatch(f"expected numbers as '{key}', got {type(answer[key]).__name__} of type {numbers.dtype}")
    return numbers
