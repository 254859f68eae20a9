"""What a suite says of a checkpoint of LeRobot, held against what the checkpoint says of itself."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from adapters.contract import PROPRIOCEPTION_DIM
from policies.contract import PolicyError, PolicyMismatch, PolicySpec, Sees
from policies.lerobot.child import looks_every_step
from policies.remote.card import CONVENTION_OPTIONS, Convention, Key, first_fault
from suites.vocabulary import CAMERAS, content_hash

NAME = "lerobot"
IMAGES, STATE, ACTION = "observation.images.", "observation.state", "action"
FILES = ("config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json")
"""Without which a folder is no checkpoint of LeRobot 0.4 or newer."""
OPTIONS = {
    "checkpoint": "a folder, or the id of a repository on the Hugging Face hub: USER/NAME, or USER/NAME@REVISION",
    "device": "cpu, cuda, ...; by default cpu",
    "python": "the Python of an environment with LeRobot; by default that of `gauntlet env create lerobot`",
    "timeout_s": "seconds to wait for an answer, and ten times that to load",
    **{name: meaning for name, meaning in CONVENTION_OPTIONS.items() if name not in ("instruction", "actions")},
}
"""Option to what it means."""


class Card(Convention):
    """The options of the kind `lerobot`."""

    checkpoint: Annotated[str, Field(min_length=1, max_length=1000)]
    device: Annotated[str, Field(pattern=r"^[a-z]+(:[0-9]+)?$")] = "cpu"
    python: str | None = None
    timeout_s: Annotated[float, Field(gt=0, le=3600)] = 60.0
    cameras: dict[str, Key] = Field(default_factory=dict)
    """Camera to the checkpoint's feature; empty if the names tell."""
    proprioception: Key | None = STATE
    instruction: None = None
    """LeRobot is told it as it is."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint's folder and how it is asked."""

    folder: Path
    card: Card
    """With the cameras that the checkpoint's own names tell, and without proprioception if it was trained without."""
    spec: PolicySpec

    def digest(self) -> str:
        """Hash of the checkpoint's files and of how it is asked; not of where it lies, or computes."""
        asked = self.card.model_dump(mode="json", exclude={"checkpoint", "device", "python", "timeout_s"})
        return content_hash({"policy": NAME, "asked": asked, "files": [_hash(path) for path in files(self.folder)]})


def read_checkpoint(options: Mapping[str, Any]) -> Checkpoint:
    """A suite's options with the checkpoint that they name.

    Raises:
        PolicyError: There is none, or an option is not what it should be.
        PolicyMismatch: The options do not fit the checkpoint, or it does not fit our observations and actions.
    """
    try:
        card = Card.model_validate(dict(options)).spelled_out()
    except ValidationError as error:
        fault = first_fault(error).removeprefix("all of it: ").replace("Value error, ", "")
        raise PolicyError(f"policy '{NAME}': {' '.join(fault.split())}") from None
    folder = _folder(card.checkpoint)
    if missing := [name for name in FILES if not (folder / name).is_file()]:
        raise PolicyError(
            f"policy '{NAME}': expected a checkpoint of LeRobot 0.4 or newer in {folder}, it lacks {missing[0]}"
        )
    try:
        config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        seen, done = config["input_features"], config["output_features"]
        shapes = {name: tuple(map(int, feature["shape"])) for name, feature in {**seen, **done}.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise PolicyError(
            f"policy '{NAME}': {folder / 'config.json'} is no configuration of LeRobot: {error}"
        ) from None
    state = card.proprioception if card.proprioception in shapes else None
    card = card.model_copy(update={"cameras": card.cameras or _cameras(shapes), "proprioception": state})
    spec = _fitting(card, shapes, 1 if looks_every_step(config) else int(config.get("n_action_steps", 1)))
    return Checkpoint(folder, card, spec)


def files(folder: Path) -> tuple[Path, ...]:
    """What is read of a checkpoint."""
    return tuple(sorted(path for path in folder.iterdir() if path.suffix in (".json", ".safetensors")))


def _cameras(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, str]:
    images = [name for name, shape in shapes.items() if name.startswith("observation.image") and len(shape) == 3]
    named = {camera: f"{IMAGES}{camera}" for camera in CAMERAS if f"{IMAGES}{camera}" in images}
    if len(images) == 1 and not named:
        return {CAMERAS[0]: images[0]}
    if len(named) < len(images):
        raise PolicyMismatch(
            f"policy '{NAME}': expected to be told which of {', '.join(images)} is which camera; give option cameras: "
            f"{{{CAMERAS[0]}: {images[0]}, ...}}"
        )
    return named


def _fitting(card: Card, shapes: Mapping[str, tuple[int, ...]], actions: int) -> PolicySpec:
    """What the policy needs, if the card covers what the checkpoint was trained on."""

    def mismatch(what: str) -> PolicyMismatch:
        return PolicyMismatch(f"policy '{NAME}': {what}")

    state = card.proprioception
    given = [*card.cameras.values(), state]
    if unknown := [name for name in card.cameras.values() if name not in shapes]:
        raise mismatch(f"cameras: expected a feature of the checkpoint, {', '.join(shapes)}; got {unknown[0]}")
    if lacking := [name for name in shapes if name != ACTION and name not in given]:
        raise mismatch(f"the checkpoint needs {lacking[0]}, which no option gives it; see docs/lerobot.md")
    if state is not None and shapes[state] != (PROPRIOCEPTION_DIM,):
        raise mismatch(
            f"expected {state} of {PROPRIOCEPTION_DIM} numbers (position, axis-angle, fingers), the checkpoint was "
            f"trained on {shapes[state]}"
        )
    sizes = {shapes[name][1:] for name in card.cameras.values()}
    if len(sizes) > 1:
        raise mismatch(f"expected images of one size, the checkpoint was trained on {sorted(sizes)}")
    (size,) = sizes or {()}
    wanted = (card.image_size,) * 2 if isinstance(card.image_size, int) else card.image_size
    if wanted is not None and wanted != size:
        raise mismatch(f"image_size: expected {list(size)}, as the checkpoint was trained on, got {list(wanted)}")
    if wanted is None and size and size[0] != size[1]:
        raise mismatch(f"expected option image_size: {list(size)}, as the checkpoint was trained on; images are square")
    width = shapes.get(ACTION, (0,))[0]
    columns = card.columns or (range(width) if width == card.width else None)
    if columns is None or any(column is not None and column >= width for column in columns):
        raise mismatch(f"columns: expected which of the checkpoint's {width} numbers are our {card.width}")
    execute = min(actions, card.execute or actions)
    cameras = tuple(card.cameras)
    return PolicySpec(Sees.OBSERVATION, execute, cameras=cameras, image_size=size[0] if size and not wanted else None)


def _folder(checkpoint: str) -> Path:
    """The checkpoint's folder; what is on the hub is fetched, tables and weights only.

    Raises:
        PolicyError: It is neither here nor there.
    """
    path = Path(checkpoint).expanduser()
    if path.is_dir():
        return path.resolve()
    repository, _, revision = checkpoint.partition("@")
    if not re.fullmatch(r"[\w.-]+/[\w.-]+", repository) or checkpoint.startswith("."):
        raise PolicyError(f"policy '{NAME}': expected a folder or an id on the hub, got '{checkpoint}'")
    try:
        from huggingface_hub import snapshot_download

        fetched = snapshot_download(
            repository, revision=revision or None, allow_patterns=["*.json", "*.safetensors"], max_workers=2
        )
    except ModuleNotFoundError:
        raise PolicyError(f"policy '{NAME}': no folder {checkpoint}, and no huggingface_hub to fetch it with") from None
    except Exception as error:  # the hub's client raises its own, and those of its transports
        lines = [line for line in str(error).strip().splitlines() if line.strip()] or [type(error).__name__]
        raise PolicyError(
            f"policy '{NAME}': no folder {checkpoint}, and the hub does not give it: {lines[0]}"
        ) from None
    return Path(fetched)


def _hash(path: Path) -> list[str]:
    state = path.stat()
    return [path.name, _content(os.path.realpath(path), state.st_mtime_ns, state.st_size)]


@lru_cache(maxsize=256)
def _content(path: str, changed_ns: int, size: int) -> str:
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
