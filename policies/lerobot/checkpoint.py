"""A LeRobot checkpoint: its options in a suite, checked against the checkpoint's configuration."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError

from robogauntlet.adapters.contract import PROPRIOCEPTION_DIM
from robogauntlet.policies.contract import PolicyError, PolicyInput, PolicyMismatch, PolicySpec
from robogauntlet.policies.hub import check_download
from robogauntlet.policies.lerobot.child import observes_every_step
from robogauntlet.policies.remote.conversion import MAX_ACTIONS
from robogauntlet.policies.remote.server_options import ACTIONS_KEY, CONVENTION_OPTIONS, Convention, Key
from robogauntlet.policies.stored import first_fault
from robogauntlet.suites.episode import CAMERAS, content_hash
from robogauntlet.support.errors import first_line
from robogauntlet.support.files import open_regular, read_regular
from robogauntlet.support.json_text import parse_json, whole_number
from robogauntlet.support.secret_variables import variable_names

NAME = "lerobot"
IMAGES, STATE, ACTION = "observation.images.", "observation.state", "action"
FILES = ("config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json")
"""The files of a checkpoint of LeRobot 0.4 or newer."""
LIBERO_CAMERAS = {"third_person": ("image",), "wrist": ("image2", "wrist_image")}
"""Camera to its names in LeRobot's copies of LIBERO's data."""
LARGEST_DIMENSION = 1_000_000
NUMBERS = {"n_action_steps": (1, 1, MAX_ACTIONS), "n_obs_steps": (1, 1, 1000), "empty_cameras": (0, 0, 100)}
"""Numbers that are read of a configuration: default, least and largest."""
OPTIONS = {
    "checkpoint": "a folder, or the id of a repository on the Hugging Face hub: USER/NAME, or USER/NAME@REVISION",
    "device": "cpu, cuda, ...; by default cpu",
    "python": "the Python of an environment with LeRobot; by default that of `robogauntlet env create lerobot`",
    "timeout_s": "seconds to wait for an answer; loading may take ten times as long",
    "variables": "environment variables that it needs, such as [HF_TOKEN]; it gets no other secret",
    **{name: meaning for name, meaning in CONVENTION_OPTIONS.items() if name not in ("instruction", "actions")},
    "proprioception": "feature of the numbers; null to leave them out",
}
"""Option to its meaning."""


class LeRobotOptions(Convention):
    """The options of the kind `lerobot`."""

    checkpoint: Annotated[str, Field(min_length=1, max_length=1000)]
    device: Annotated[str, Field(pattern=r"^[a-z]+(:[0-9]+)?$")] = "cpu"
    python: str | None = None
    timeout_s: Annotated[float, Field(gt=0, le=3600)] = 60.0
    variables: Annotated[tuple[str, ...], BeforeValidator(variable_names)] = ()
    cameras: dict[str, Key] = Field(default_factory=dict)
    """Camera to the checkpoint's feature; empty to match them by name."""
    proprioception: Key | None = STATE
    actions: Key = ACTIONS_KEY
    instruction: None = None
    """LeRobot gets the instruction unchanged."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint's folder, and how observations and actions are converted for it."""

    folder: Path
    options: LeRobotOptions
    """With the cameras that match by name, without proprioception if it was trained without."""
    spec: PolicySpec
    numbers: int
    """Numbers of the state that it is given."""

    def digest(self) -> str:
        """Return the hash of the checkpoint's files and of the conversions; not of its folder or device."""
        left_out = {"checkpoint", "device", "python", "timeout_s", "variables"}
        if self.options.joints is None:  # Digests from before there were joints stay.
            left_out |= {"joints", "joint_scale"}
        if self.options.velocity_scale is None:
            left_out |= {"velocity_scale"}
        if self.options.arms == 1:
            left_out |= {"arms"}
        conversion = self.options.model_dump(mode="json", exclude=left_out)
        try:
            states = [(path, path.stat()) for path in files(self.folder)]
            hashes = [
                [path.name, _content(os.path.realpath(path), state.st_mtime_ns, state.st_size)]
                for path, state in states
            ]
        except OSError as error:
            raise PolicyError(f"policy '{NAME}': {error.filename}: {error.strerror}") from None
        return content_hash({"policy": NAME, "asked": conversion, "files": hashes})


def read_checkpoint(suite_options: Mapping[str, Any]) -> Checkpoint:
    """Read a suite's options and the checkpoint that they name.

    Raises PolicyError if there is no such checkpoint or an option is invalid, PolicyMismatch if the options do not fit
    the checkpoint, or it does not fit our observations and actions.
    """
    try:
        options = LeRobotOptions.model_validate(dict(suite_options)).resolved()
    except ValidationError as error:
        raise PolicyError(f"policy '{NAME}': {first_fault(error)}") from None
    folder = _folder(options.checkpoint)
    if missing := [name for name in FILES if not (folder / name).is_file()]:
        raise PolicyError(
            f"policy '{NAME}': expected a checkpoint of LeRobot 0.4 or newer in {folder}, it lacks {missing[0]}"
        )
    declared = _declared(folder / "config.json")
    state = options.proprioception if options.proprioception in declared.shapes else None
    cameras = options.cameras or _cameras(declared, options.convention)
    options = options.model_copy(update={"cameras": cameras, "proprioception": state})
    numbers = declared.shapes[state][0] if state else 0
    return Checkpoint(folder, options, _spec(options, declared), numbers)


def files(folder: Path) -> tuple[Path, ...]:
    """Return the files of a checkpoint that are read. Raises PolicyError if the folder cannot be read."""
    try:
        return tuple(sorted(path for path in folder.iterdir() if path.suffix in (".json", ".safetensors")))
    except OSError as error:
        raise PolicyError(f"policy '{NAME}': {folder}: {error.strerror}") from None


@dataclass(frozen=True)
class _Declared:
    """What a checkpoint's `config.json` says of its observations and actions."""

    shapes: Mapping[str, tuple[int, ...]]
    """Feature to the shape of its arrays."""
    actions: int
    """Actions that follow from one observation."""
    unfilled: frozenset[str]
    """Cameras that need no source, since LeRobot fills them."""


def _declared(path: Path) -> _Declared:
    """Read a configuration. Raises PolicyError in one line, whatever the file holds."""
    try:
        config = parse_json(read_regular(path))
        features = {**config["input_features"], **config["output_features"]}
        shapes = {
            name: tuple(whole_number(number, 1, LARGEST_DIMENSION) for number in feature["shape"])
            for name, feature in features.items()
        }
        if not all(shapes.values()):
            raise ValueError(f"a feature without a shape, {next(name for name in shapes if not shapes[name])}")
        steps, seen, empty = (_number(config, *given) for given in NUMBERS.items())
    except (OSError, ValueError, KeyError, OverflowError, TypeError, AttributeError) as error:
        problem = f"no {error}" if isinstance(error, KeyError) else first_line(error)
        raise PolicyError(f"policy '{NAME}': expected a configuration of LeRobot in {path}, got: {problem}") from None
    unfilled = frozenset(f"{IMAGES}empty_camera_{number}" for number in range(empty)) & shapes.keys()
    each = observes_every_step({**config, "n_obs_steps": seen})
    return _Declared(shapes, 1 if each else steps, unfilled)


def _number(config: Mapping[str, Any], name: str, bounds: tuple[int, int, int]) -> int:
    default, lowest, highest = bounds
    try:
        return whole_number(config.get(name, default), lowest, highest)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _cameras(declared: _Declared, convention: str) -> dict[str, str]:
    """Camera to the feature of its name. Raises PolicyMismatch if a feature is left."""
    images = [
        name
        for name, shape in declared.shapes.items()
        if name.startswith("observation.image") and len(shape) == 3 and name not in declared.unfilled
    ]
    named = {camera: f"{IMAGES}{camera}" for camera in CAMERAS if f"{IMAGES}{camera}" in images}
    if len(images) == 1 and not named:
        return {CAMERAS[0]: images[0]}
    if convention == "libero" and not named:
        named = {
            camera: f"{IMAGES}{name}"
            for camera, names in LIBERO_CAMERAS.items()
            for name in names
            if f"{IMAGES}{name}" in images
        }
    if len(named) < len(images):
        example = ", ".join(f"{camera}: {image}" for camera, image in zip(CAMERAS, images, strict=False))
        raise PolicyMismatch(
            f"policy '{NAME}': expected option cameras, which assigns a camera to each of {', '.join(images)}; "
            f"for example cameras: {{{example}}}"
        )
    return named


def _spec(options: LeRobotOptions, declared: _Declared) -> PolicySpec:
    """Return the policy's spec, if the options cover the features that the checkpoint was trained on."""
    shapes = declared.shapes

    def mismatch(text: str) -> PolicyMismatch:
        return PolicyMismatch(f"policy '{NAME}': {text}")

    state = options.proprioception
    given = [*options.cameras.values(), state]
    if unknown := [name for name in options.cameras.values() if name not in shapes]:
        raise mismatch(f"cameras: expected a feature of the checkpoint, {', '.join(shapes)}; got {unknown[0]}")
    if lacking := [name for name in shapes if name not in (ACTION, *given, *declared.unfilled)]:
        raise mismatch(f"the checkpoint needs {lacking[0]}, which no option provides; see docs/your-policy.md")
    numbers = options.width if options.joints else PROPRIOCEPTION_DIM
    if state is not None and len(shapes[state]) == 1 and options.is_native:
        numbers = shapes[state][0]
    if state is not None and shapes[state] != (numbers,):
        meaning = "joints, gripper" if options.joints else "position, axis-angle, fingers"
        hint = "" if options.joints else "; for others give option convention: so101, aloha, droid or native, or joints"
        raise mismatch(
            f"expected {state} of {numbers} numbers ({meaning}), the checkpoint was trained on {shapes[state]}{hint}"
        )
    sizes = {shapes[name][1:] for name in options.cameras.values()}
    if len(sizes) > 1:
        raise mismatch(f"expected images of one size, the checkpoint was trained on {sorted(sizes)}")
    (size,) = sizes or {()}
    wanted = (options.image_size,) * 2 if isinstance(options.image_size, int) else options.image_size
    if wanted is not None and wanted != size:
        raise mismatch(f"image_size: expected {list(size)}, as the checkpoint was trained on, got {list(wanted)}")
    if wanted is None and size and size[0] != size[1]:
        raise mismatch(f"expected option image_size: {list(size)}, as the checkpoint was trained on; images are square")
    width = shapes.get(ACTION, (0,))[0]
    columns = options.columns or (range(width) if width == options.width or options.is_native else None)
    if columns is None or any(column is not None and column >= width for column in columns):
        raise mismatch(f"columns: expected the {options.width} columns of an action among the checkpoint's {width}")
    execute = min(declared.actions, options.execute or declared.actions)
    cameras = tuple(options.cameras)
    square = size[0] if size and not wanted else None
    action_dim = len(columns) if options.is_native else options.action_dim
    return PolicySpec(PolicyInput.OBSERVATION, execute, action_dim, cameras, square, moves=options.moves)


def _folder(checkpoint: str) -> Path:
    """Return the checkpoint's folder; from the hub, JSON files and weights are downloaded."""
    path = Path(checkpoint).expanduser()
    if path.is_dir():
        return path.resolve()
    repository, _, revision = checkpoint.partition("@")
    if not re.fullmatch(r"[\w.-]+/[\w.-]+", repository) or checkpoint.startswith("."):
        raise PolicyError(f"policy '{NAME}': expected a folder or an id on the hub, got '{checkpoint}'")
    check_download(checkpoint)
    try:
        from huggingface_hub import snapshot_download

        downloaded = snapshot_download(
            repository, revision=revision or None, allow_patterns=["*.json", "*.safetensors"], max_workers=2
        )
    except ModuleNotFoundError:
        raise PolicyError(
            f"policy '{NAME}': expected a folder, got '{checkpoint}'; install huggingface_hub to download it"
        ) from None
    except Exception as error:  # the hub's client also raises errors of its transports
        raise PolicyError(
            f"policy '{NAME}': no folder {checkpoint}, and the hub does not provide it: {first_line(error)}"
        ) from None
    return Path(downloaded)


@lru_cache(maxsize=256)
def _content(path: str, changed_ns: int, size: int) -> str:
    with open_regular(Path(path)) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
