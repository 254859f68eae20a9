"""Options of MergeVLA's policies in a suite, and the checkpoints that they name. Light: no torch."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from robogauntlet.policies.contract import PolicyError, PolicyNotInstalled
from robogauntlet_mergevla.checkpoints.merged_metadata import KIND
from robogauntlet_mergevla.checkpoints.metadata import (
    METADATA_FILE,
    CheckpointError,
    CheckpointMetadata,
    read_metadata_file,
)
from robogauntlet_mergevla.merging.recipe import Recipe
from robogauntlet_mergevla.zoo import shipped

NAME, EXPERTS_NAME, MERGED_NAME = "mergevla", "mergevla-experts", "mergevla-merged"
ROUTER = "calibrated"
"""The default router of a merged policy."""


PACKAGES = ("torch", "transformers", "peft", "accelerate", "safetensors")
"""Modules that the networks import, of the extra `mergevla`."""
CPU = "cpu"
DEVICE_MEANING = "cpu, cuda or cuda:N; by default cpu"


@contextmanager
def needs_packages(policy: str) -> Iterator[None]:
    """Turn a ModuleNotFoundError within the block into PolicyNotInstalled, which says what to install."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise PolicyNotInstalled(
            f"policy '{policy}': not installed (no module {error.name}); "
            "in a clone of the repository: pip install ./mergevla"
        ) from None


def check_packages(policy: str) -> None:
    """Raise PolicyNotInstalled without a package that the networks need."""
    with needs_packages(policy):
        for name in PACKAGES:
            if find_spec(name) is None:
                raise ModuleNotFoundError(name=name)


def text_option(policy: str, options: Mapping[str, Any], option: str, meaning: str) -> str:
    """Return a required text option. The PolicyError for another value explains the option as `meaning`."""
    value = options.get(option)
    if not isinstance(value, str) or not value:
        raise PolicyError(f"policy '{policy}': expected option {option}: {meaning}, got {value!r}")
    return value


def device_option(policy: str, options: Mapping[str, Any]) -> str:
    """Return the option `device`. Raises PolicyError for another value than a device."""
    device = text_option(policy, {"device": CPU, **options}, "device", DEVICE_MEANING)
    if not re.fullmatch(r"cpu|cuda(:(0|[1-9][0-9]?))?", device):
        raise PolicyError(f"policy '{policy}': expected option device: {DEVICE_MEANING}, got {device!r}")
    return device


def expert_folders(folder: Path) -> dict[str, Path]:
    """Return the experts in a folder of checkpoints, task to folder. Bases and merged checkpoints are left out.

    Raises PolicyError without experts, for two of one task, or one that cannot be read.
    """
    try:
        if not folder.is_dir():
            raise CheckpointError(f"expected a folder of expert checkpoints, got '{folder}'")
        # A glob would silently skip unreadable folders.
        checkpoints = sorted(path for path in folder.iterdir() if (path / METADATA_FILE).is_file())
    except OSError as error:
        raise CheckpointError(f"expected to read '{error.filename or folder}', got: {error.strerror}") from None
    experts: dict[str, Path] = {}
    for path in checkpoints:
        if read_metadata_file(path).get("kind") == KIND:
            continue
        metadata = CheckpointMetadata.read(path)
        if metadata.base is None:
            continue
        for task in metadata.tasks:
            if task in experts:
                raise CheckpointError(
                    f"'{folder}': expected one expert per task, got {experts[task]} and {path} for {task}"
                )
            experts[task] = path
    if not experts:
        raise CheckpointError(f"expected a folder of expert checkpoints, got '{folder}', which holds none")
    return experts


@dataclass(frozen=True)
class MergedOptions:
    """Options of a merged policy."""

    checkpoint: str
    """A folder or a hub id."""
    router: str
    sees_instruction: bool
    expert_sees_instruction: bool
    recipe: Recipe | None
    """How to merge `experts` when the policy is loaded; the checkpoint then provides its fitted routers only."""
    experts: Path | None
    """Folder of expert checkpoints; present with a recipe."""
    device: str
    """Where it computes."""


def merged_options(options: Mapping[str, Any]) -> MergedOptions:
    """Read a suite's options. Raises PolicyError if one is missing or invalid."""
    checkpoint = text_option(MERGED_NAME, options, "checkpoint", "a folder or hub id")
    router = text_option(MERGED_NAME, {"router": ROUTER, **options}, "router", "a router's name")
    sees, expert_sees = (options.get(name, True) for name in ("sees_instruction", "expert_sees_instruction"))
    for name, value in (("sees_instruction", sees), ("expert_sees_instruction", expert_sees)):
        if not isinstance(value, bool):
            raise PolicyError(f"policy '{MERGED_NAME}': expected option {name}: true or false, got {value!r}")
    device = device_option(MERGED_NAME, options)
    plain, folder = options.get("recipe"), options.get("experts")
    if (plain is None) != (folder is None):
        raise PolicyError(f"policy '{MERGED_NAME}': expected options recipe and experts together, got one of them")
    if plain is None:
        return MergedOptions(checkpoint, router, sees, expert_sees, None, None, device)
    if not isinstance(plain, Mapping):
        raise PolicyError(f"policy '{MERGED_NAME}': expected option recipe: how to merge, got {plain!r}")
    experts = shipped(text_option(MERGED_NAME, options, "experts", "a folder of expert checkpoints"))
    return MergedOptions(checkpoint, router, sees, expert_sees, Recipe.from_json(plain), experts, device)
