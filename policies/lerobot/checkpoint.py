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

from robogauntlet.adapters.contract import ACTION_DIM, PROPRIOCEPTION_DIM
from robogauntlet.policies.contract import PolicyError, PolicyInput, PolicyMismatch, PolicySpec
from robogauntlet.policies.hub import check_download
from robogauntlet.policies.lerobot.child import observes_every_step
from robogauntlet.policies.remote.server_options import CONVENTION_OPTIONS, Convention, Key
from robogauntlet.policies.stored import first_fault
from robogauntlet.suites.episode import CAMERAS, content_hash
from robogauntlet.support.errors import first_line
from robogauntlet.support.json_text import parse_json
from robogauntlet.support.secret_variables import variable_names

NAME = "lerobot"
IMAGES, STATE, ACTION = "observation.images.", "observation.state", "action"
FILES = ("config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json")
"""The files of a checkpoint of LeRobot 0.4 or newer."""
OPTIONS = {
    "checkpoint": "a folder, or the id of a repository on the Hugging Face hub: USER/NAME, or USER/NAME@REVISION",
    "device": "cpu, cuda, ...; by default cpu",
    "python": "the Python of an environment with LeRobot; by default that of `robogauntlet env create lerobot`",
    "timeout_s": "seconds to wait for an answer; loading may take ten times as long",
    "variables": "environment variables that it needs, such as [HF_TOKEN]; it gets no other secret",
    **{name: meaning for name, meaning in CONVENTION_OPTIONS.items() if name not in ("instruction", "actions")},
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
    instruction: None = None
    """LeRobot gets the instruction unchanged."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint's folder, and how observations and actions are converted for it."""

    folder: Path
    options: LeRobotOptions
    """With the cameras that match by name, and without proprioception if it was trained without."""
    spec: PolicySpec

    def digest(self) -> str:
        """Return the hash of the checkpoint's files and of the conversions; not of its folder or device."""
        left_out = {"checkpoint", "device", "python", "timeout_s", "variables"}
        if self.options.joints is None:  # Digests from before there were joints stay.
            left_out |= {"joints", "joint_scale"}
        conversion = self.options.model_dump(mode="json", exclude=left_out)
        states = [(path, path.stat()) for path in files(self.folder)]
        hashes = [
            [path.name, _content(os.path.realpath(path), state.st_mtime_ns, state.st_size)] for path, state in states
        ]
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
    try:
        config = parse_json((folder / "config.json").read_text(encoding="utf-8"))
        features = {**config["input_features"], **config["output_features"]}
        shapes = {name: tuple(map(int, feature["shape"])) for name, feature in features.items()}
    except (OSError, ValueError, KeyError, OverflowError, TypeError, AttributeError) as error:
        path = folder / "config.json"
        raise PolicyError(f"policy '{NAME}': expected a configuration of LeRobot in {path}, got: {error}") from None
    state = options.proprioception if options.proprioception in shapes else None
    options = options.model_copy(update={"cameras": options.cameras or _cameras(shapes), "proprioception": state})
    spec = _spec(options, shapes, 1 if observes_every_step(config) else int(config.get("n_action_steps", 1)))
    return Checkpoint(folder, options, spec)


def files(folder: Path) -> tuple[Path, ...]:
    """Return the files of a checkpoint that are read."""
    return tuple(sorted(path for path in folder.iterdir() if path.suffix in (".json", ".safetensors")))


def _cameras(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, str]:
    images = [name for name, shape in shapes.items() if name.startswith("observation.image") and len(shape) == 3]
    named = {camera: f"{IMAGES}{camera}" for camera in CAMERAS if f"{IMAGES}{camera}" in images}
    if len(images) == 1 and not named:
        return {CAMERAS[0]: images[0]}
    if len(named) < len(images):
        raise PolicyMismatch(
            f"policy '{NAME}': expected option cameras, which assigns a camera to each of {', '.join(images)}; "
            f"for example cameras: {{{CAMERAS[0]}: {images[0]}, ...}}"
        )
    return named


def _spec(options: LeRobotOptions, shapes: Mapping[str, tuple[int, ...]], actions: int) -> PolicySpec:
    """Return the policy's spec, if the options cover the features that the checkpoint was trained on."""

    def mismatch(text: str) -> PolicyMismatch:
        return PolicyMismatch(f"policy '{NAME}': {text}")

    state = options.proprioception
    given = [*options.cameras.values(), state]
    if unknown := [name for name in options.cameras.values() if name not in shapes]:
        raise mismatch(f"cameras: expected a feature of the checkpoint, {', '.join(shapes)}; got {unknown[0]}")
    if lacking := [name for name in shapes if name != ACTION and name not in given]:
        raise mismatch(f"the checkpoint needs {lacking[0]}, which no option provides; see docs/lerobot.md")
    numbers = options.width if options.joints else PROPRIOCEPTION_DIM
    if state is not None and shapes[state] != (numbers,):
        meaning = "joints, gripper" if options.joints else "position, axis-angle, fingers"
        hint = "" if options.joints else "; for the joints of an SO-101 give option convention: so101"
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
    columns = options.columns or (range(width) if width == options.width else None)
    if columns is None or any(column is not None and column >= width for column in columns):
        raise mismatch(f"columns: expected the {options.width} columns of an action among the checkpoint's {width}")
    execute = min(actions, options.execute or actions)
    cameras = tuple(options.cameras)
    square = size[0] if size and not wanted else None
    action_dim = options.width if options.joints else ACTION_DIM
    return PolicySpec(PolicyInput.OBSERVATION, execute, action_dim, cameras, square)


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
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
