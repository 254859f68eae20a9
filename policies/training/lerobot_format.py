"""The LeRobot v3 dataset layout: file names, columns, and the encoding of episodes.

The layout is that of `lerobot` 0.4 (codebase version v3.0): `meta/info.json`, `meta/stats.json`, `meta/tasks.parquet`,
`meta/episodes/chunk-000/file-000.parquet` and `data/chunk-000/file-000.parquet`. Images are embedded in the data files
as lossless PNG, as `datasets.Image` stores them; there is no video. A dataset has one control rate, so there is one
dataset per task. LeRobot ignores `meta/robogauntlet.json`.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from robogauntlet.adapters.contract import ACTION_DIM, ARM_PREFIXES, GRIPPER, VELOCITY, Body, FloatArray, Image
from robogauntlet.policies.stored import StoredError

CODEBASE_VERSION = "v3.0"
INFO_FILE, STATS_FILE, TASKS_FILE = "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
ROBOT = "panda"
"""`robot_type` where a tool is moved."""
NATIVE = "native"
"""`robot_type` where numbers are the environment's own."""
JOURNAL_FILE = "meta/robogauntlet.json"
EPISODES_FILE = "meta/episodes/chunk-000/file-000.parquet"
DATA_FILE = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
FILES_PER_CHUNK = 1000
STATE, ACTION, SUCCESS = "observation.state", "action", "next.success"
PNG_LEVEL = 3
MAX_FPS, MAX_SIZE = 10_000, 8192
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Floats = NDArray[np.float32]


class DatasetError(StoredError):
    """A dataset that cannot be read or written."""


@dataclass(frozen=True)
class Recording:
    """One played episode: the observation before and the commanded action in each of its n control steps."""

    seed: int
    instruction: str
    control_hz: float
    states: FloatArray
    """Proprioception before the step, shape (n, numbers), see `robogauntlet.adapters.contract`."""
    actions: FloatArray
    """Commanded actions, shape (n, numbers), without the noise that was executed with them."""
    success: NDArray[np.bool_]
    """The task's predicate after the step, shape (n,)."""
    images: Mapping[str, Sequence[Image]]
    """Camera name to n images (size, size, 3)."""
    body: Body = field(default_factory=Body)
    """What acts."""


@dataclass(frozen=True)
class DatasetSpec:
    """Properties that all episodes of one dataset share."""

    fps: int
    """Control steps per second; each step is one frame."""
    cameras: tuple[str, ...]
    image_size: int
    """Height and width (px)."""
    body: Body = field(default_factory=Body)
    """What acts."""


@dataclass(frozen=True)
class EncodedEpisode:
    """A recording in its stored form."""

    seed: int
    instruction: str
    spec: DatasetSpec
    states: Floats
    actions: Floats
    success: NDArray[np.bool_]
    images: Mapping[str, tuple[bytes, ...]]
    """Camera name to n PNG files."""
    image_statistics: Mapping[str, Mapping[str, Any]]
    """Camera name to minimum, maximum, mean and standard deviation of each channel in [0, 1], shape (3, 1, 1)."""
    content_hash: str
    """See `episode_hash`."""

    def __len__(self) -> int:
        return len(self.actions)

    @property
    def size(self) -> int:
        """Size of the images (bytes), nearly all of the episode."""
        return sum(len(png) for camera in self.images.values() for png in camera)


def image_key(camera: str) -> str:
    """Return the column of a camera's images."""
    return f"observation.images.{camera}"


def spec_of(info: Mapping[str, Any]) -> DatasetSpec:
    """Return the spec in the content of `meta/info.json`. Raises ValueError, KeyError or TypeError if it has none."""
    prefix = image_key("")
    images = {name.removeprefix(prefix): f for name, f in info["features"].items() if name.startswith(prefix)}
    fps, size = int(info["fps"]), int(next(iter(images.values()))["shape"][0])
    if not 1 <= fps <= MAX_FPS or not 1 <= size <= MAX_SIZE:
        raise ValueError(
            f"expected 1 to {MAX_FPS} frames per second and images of 1 to {MAX_SIZE} px, got fps {fps} and {size} px"
        )
    action, state = info["features"][ACTION], info["features"][STATE]
    body = _body(action)
    if info.get("robot_type") == NATIVE:
        body = Body(native=tuple(map(str, action["names"])), state=tuple(map(str, state["names"])))
    return DatasetSpec(fps, tuple(images), size, body)


def _body(action: Mapping[str, Any]) -> Body:
    """Return the body whose numbers an action has; without their names, by its size, tools are moved."""
    names = list(map(str, action["names"])) if isinstance(action["names"], list) else []
    arms = 2 if names[-1:] == [ARM_PREFIXES[1] + GRIPPER] else 1
    one = names[: len(names) // arms]
    if one[-1:] == [GRIPPER] and len(one) > 1 and one[0] not in Body().action_names:
        velocities = one[0].endswith(VELOCITY)
        return Body(arms, tuple(name.removesuffix(VELOCITY) if velocities else name for name in one[:-1]), velocities)
    return Body(2 if action["shape"] == [2 * ACTION_DIM] else 1)


def encode_episode(recording: Recording) -> EncodedEpisode:
    """Compress a recording's images and hash its content.

    Raises DatasetError if shapes disagree, a number is not finite, or the control rate is not a whole number.
    """
    n = len(recording.actions)
    fps = round(recording.control_hz)
    if abs(fps - recording.control_hz) > 1e-6 or fps < 1:
        raise DatasetError(f"expected a whole number of control steps per second, got {recording.control_hz}")
    if n == 0 or not recording.images:
        raise DatasetError(f"expected at least one step and one camera, got {n} and {len(recording.images)}")
    stacked = {camera: np.stack(list(frames)) for camera, frames in recording.images.items()}
    size = next(iter(stacked.values())).shape[1]
    _check_shape("states", recording.states, (n, recording.body.proprioception_dim))
    _check_shape("actions", recording.actions, (n, recording.body.action_dim))
    _check_shape("success", recording.success, (n,))
    for camera, frames in stacked.items():
        _check_shape(f"images of {camera}", frames, (n, size, size, 3))
    states, actions = recording.states.astype(np.float32), recording.actions.astype(np.float32)
    if not (np.isfinite(states).all() and np.isfinite(actions).all()):
        raise DatasetError("expected finite states and actions, got NaN or infinity")
    success = recording.success.astype(np.bool_)
    return EncodedEpisode(
        recording.seed,
        recording.instruction,
        DatasetSpec(fps, tuple(stacked), size, recording.body),
        states,
        actions,
        success,
        {camera: tuple(map(encode_png, frames)) for camera, frames in stacked.items()},
        {camera: _image_statistics(frames) for camera, frames in stacked.items()},
        episode_hash(recording.instruction, fps, states, actions, success, stacked),
    )


def episode_hash(
    instruction: str,
    fps: int,
    states: Floats,
    actions: Floats,
    success: NDArray[np.bool_],
    images: Mapping[str, NDArray[np.uint8]],
) -> str:
    """Return the SHA-256 of an episode's numbers and pixels, 16 hexadecimal digits, independent of their storage."""
    head = {"instruction": instruction, "fps": fps, "cameras": sorted(images), "shape": [len(actions)]}
    digest = hashlib.sha256(json.dumps(head, sort_keys=True).encode())
    for values, kind in ((states, "<f4"), (actions, "<f4"), (success, "u1")):
        digest.update(np.ascontiguousarray(values, dtype=kind).tobytes())
    for camera in sorted(images):
        digest.update(np.ascontiguousarray(images[camera]).tobytes())
    return digest.hexdigest()[:16]


def encode_png(image: Image) -> bytes:
    """Encode an RGB image (h, w, 3) as PNG."""
    from PIL import Image as Pillow

    buffer = io.BytesIO()
    Pillow.fromarray(image).save(buffer, "png", compress_level=PNG_LEVEL)
    return buffer.getvalue()


def decode_png(png: bytes) -> Image:
    """Decode a PNG to an RGB image (h, w, 3). Raises DatasetError for another format."""
    from PIL import Image as Pillow

    try:
        with Pillow.open(io.BytesIO(png), formats=("PNG",)) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError):
        raise DatasetError(f"expected a PNG image, got {len(png)} bytes of another format") from None


def features(spec: DatasetSpec) -> dict[str, dict[str, Any]]:
    """Return the columns in the form of `meta/info.json`."""
    shape = [spec.image_size, spec.image_size, 3]
    names = ["height", "width", "channels"]
    numbers = {STATE: spec.body.proprioception_names, ACTION: spec.body.action_names}
    return {
        **{key: {"dtype": "float32", "shape": [len(each)], "names": list(each)} for key, each in numbers.items()},
        **{image_key(camera): {"dtype": "image", "shape": shape, "names": names} for camera in spec.cameras},
        SUCCESS: {"dtype": "bool", "shape": [1], "names": None},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        **{
            name: {"dtype": "int64", "shape": [1], "names": None}
            for name in ("frame_index", "episode_index", "index", "task_index")
        },
    }


def schema(spec: DatasetSpec) -> pa.Schema:
    """Return the Arrow schema of the data files, with the metadata from which `datasets` decodes the images."""
    scalars = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
    fields: list[pa.Field] = []
    hints: dict[str, Any] = {}
    for name, feature in features(spec).items():
        if feature["dtype"] == "image":
            fields.append(pa.field(name, pa.struct([("bytes", pa.binary()), ("path", pa.string())])))
            hints[name] = {"_type": "Image"}
            continue
        kind, length = scalars[feature["dtype"]], feature["shape"][0]
        hint = {"dtype": feature["dtype"], "_type": "Value"}
        fields.append(pa.field(name, kind if length == 1 else pa.list_(kind, length)))
        hints[name] = hint if length == 1 else {"feature": hint, "length": length, "_type": "Sequence"}
    return pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": hints}})})


def episode_table(episode: EncodedEpisode, *, episode_index: int, first_index: int, task_index: int) -> pa.Table:
    """Return an episode's rows, given the numbers of episode, first frame and instruction in the dataset."""
    n = len(episode)
    frame = np.arange(n)
    columns: dict[str, Any] = {
        STATE: list(episode.states),
        ACTION: list(episode.actions),
        **{
            image_key(camera): [{"bytes": png, "path": None} for png in frames]
            for camera, frames in episode.images.items()
        },
        SUCCESS: episode.success,
        "timestamp": (frame / episode.spec.fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(n, episode_index),
        "index": first_index + frame,
        "task_index": np.full(n, task_index),
    }
    return pa.table(columns, schema=schema(episode.spec))


def numbers(table: pa.Table, name: str) -> NDArray[Any]:
    """Return a column of numbers, shape (n, d)."""
    column = table.column(name).combine_chunks()
    if pa.types.is_fixed_size_list(column.type):
        return column.flatten().to_numpy().reshape(len(column), column.type.list_size)
    return column.to_numpy(zero_copy_only=False)[:, None]


def number_statistics(values: NDArray[Any]) -> dict[str, Any]:
    """Return LeRobot's statistics of each column of (n, d): plain lists of length d, and the count."""
    values = values.astype(np.float64)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(values)],
        **{name: np.quantile(values, q, axis=0).tolist() for name, q in QUANTILES.items()},
    }


def pooled_image_statistics(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Pool the image statistics of several episodes: exact, since all images are of one size."""
    counts = np.array([part["count"][0] for part in parts], dtype=np.float64)
    shares = (counts / counts.sum())[:, None, None, None]
    means = np.array([part["mean"] for part in parts])
    squares = np.array([part["std"] for part in parts]) ** 2 + means**2
    mean = (shares * means).sum(axis=0)
    return {
        "min": np.min([part["min"] for part in parts], axis=0).tolist(),
        "max": np.max([part["max"] for part in parts], axis=0).tolist(),
        "mean": mean.tolist(),
        "std": np.sqrt(np.maximum((shares * squares).sum(axis=0) - mean**2, 0.0)).tolist(),
        "count": [int(counts.sum())],
    }


def _image_statistics(frames: NDArray[np.uint8]) -> dict[str, Any]:
    scaled = frames.reshape(-1, 3) / 255.0
    statistics = {"min": scaled.min(0), "max": scaled.max(0), "mean": scaled.mean(0), "std": scaled.std(0)}
    return {**{name: values.reshape(3, 1, 1).tolist() for name, values in statistics.items()}, "count": [len(frames)]}


def _check_shape(name: str, values: NDArray[Any], expected: tuple[int, ...]) -> None:
    if values.shape != expected:
        raise DatasetError(f"{name}: expected shape {expected}, got {values.shape}")
