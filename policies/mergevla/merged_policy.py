"""Experts and merged models as kinds of policies. Light: torch is imported when a policy is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from policies.contract import Policy, PolicyError, PolicyFiles, PolicyKind, PolicySpec
from policies.mergevla.card import CARD, CheckpointError, card_json, digest_of, read_card
from policies.mergevla.files import all_files, checkpoint_files
from policies.mergevla.merged_card import KIND, merged_digest_of
from policies.mergevla.merging.recipe import Recipe
from policies.zoo import shipped
from suites.vocabulary import content_hash

EXPERTS_NAME, MERGED_NAME = "mergevla-experts", "mergevla-merged"
ROUTER = "calibrated"
"""The router of a merged policy that names none."""


def expert_folders(folder: Path) -> dict[str, Path]:
    """The experts in a folder of checkpoints: task to the folder of the one that was trained on it.

    What stands alone (a base) or is merged is left out.

    Raises:
        PolicyError: There is no expert, one that was trained on several tasks, a second one for a task, or one that may
            not be read.
    """
    try:
        if not folder.is_dir():
            raise CheckpointError(f"expected a folder of expert checkpoints, got '{folder}'")
        # Not by a glob, which leaves out what it may not look at.
        places = sorted(place for place in folder.iterdir() if (place / CARD).is_file())
    except OSError as error:
        raise CheckpointError(f"expected to read '{error.filename or folder}', got: {error.strerror}") from None
    found: dict[str, Path] = {}
    for place in places:
        if card_json(place).get("kind") == KIND:
            continue
        card = read_card(place)
        if card.base is None:
            continue
        if len(card.tasks) != 1:
            raise CheckpointError(f"'{place}': expected an expert for one task, got {', '.join(card.tasks)}")
        task = card.tasks[0]
        if task in found:
            raise CheckpointError(f"'{folder}': expected one expert per task, got {found[task]} and {place} for {task}")
        found[task] = place
    if not found:
        raise CheckpointError(f"expected a folder of expert checkpoints, got '{folder}', which holds none")
    return found


def _option(name: str, options: Mapping[str, Any], option: str, meaning: str) -> str:
    value = options.get(option)
    if not isinstance(value, str) or not value:
        raise PolicyError(f"policy '{name}': expected option {option}: {meaning}, got {value!r}")
    return value


def _folder(options: Mapping[str, Any]) -> Path:
    return shipped(_option(EXPERTS_NAME, options, "folder", "a folder of expert checkpoints"))


@dataclass(frozen=True)
class MergedOptions:
    """What a suite says of a merged policy."""

    checkpoint: str
    """A folder or a hub id."""
    router: str
    sees_instruction: bool
    recipe: Recipe | None
    """Merge `experts` anew like this, and take nothing but the fitted routers from the checkpoint."""
    experts: Path | None
    """Folder of expert checkpoints; present with a recipe."""


def merged_options(options: Mapping[str, Any]) -> MergedOptions:
    """Read a suite's options.

    Raises:
        PolicyError: One is missing, or is not what it should be.
    """
    checkpoint = _option(MERGED_NAME, options, "checkpoint", "a folder or hub id")
    router = _option(MERGED_NAME, {"router": ROUTER, **options}, "router", "a router's name")
    sees = options.get("sees_instruction", True)
    if not isinstance(sees, bool):
        raise PolicyError(f"policy '{MERGED_NAME}': expected option sees_instruction: true or false, got {sees!r}")
    plain, folder = options.get("recipe"), options.get("experts")
    if (plain is None) != (folder is None):
        raise PolicyError(f"policy '{MERGED_NAME}': expected options recipe and experts together, got one of them")
    if plain is None:
        return MergedOptions(checkpoint, router, sees, None, None)
    if not isinstance(plain, Mapping):
        raise PolicyError(f"policy '{MERGED_NAME}': expected option recipe: how to merge, got {plain!r}")
    experts = shipped(_option(MERGED_NAME, options, "experts", "a folder of expert checkpoints"))
    return MergedOptions(checkpoint, router, sees, Recipe.from_json(plain), experts)


def _load_experts(options: Mapping[str, Any]) -> Policy:
    folders = expert_folders(_folder(options))
    try:
        from policies.mergevla.acting_merged import ExpertsPolicy
    except ModuleNotFoundError as error:
        raise _not_installed(EXPERTS_NAME, error) from None
    return ExpertsPolicy(folders)


def _load_merged(options: Mapping[str, Any]) -> Policy:
    chosen = merged_options(options)
    try:
        from policies.mergevla.acting_merged import MergedPolicy
    except ModuleNotFoundError as error:
        raise _not_installed(MERGED_NAME, error) from None
    return MergedPolicy.of(chosen)


def _merged_spec(options: Mapping[str, Any]) -> PolicySpec:
    chosen = merged_options(options)
    try:
        from policies.mergevla.acting_merged import merged_spec
    except ModuleNotFoundError as error:
        raise _not_installed(MERGED_NAME, error) from None
    return merged_spec(chosen)


def _not_installed(name: str, error: ModuleNotFoundError) -> PolicyError:
    return PolicyError(
        f"policy '{name}': expected the packages of robogauntlet[mergevla], found none named {error.name}"
    )


def _experts_digest(options: Mapping[str, Any]) -> str:
    return content_hash({"policy": EXPERTS_NAME, "experts": _digests(_folder(options))})


def _merged_digest(options: Mapping[str, Any]) -> str:
    chosen = merged_options(options)
    content = {
        "policy": MERGED_NAME,
        "model": merged_digest_of(chosen.checkpoint),
        "router": chosen.router,
        "sees_instruction": chosen.sees_instruction,
    }
    if chosen.recipe is not None and chosen.experts is not None:
        content |= {"recipe": chosen.recipe.as_json(), "experts": _digests(chosen.experts)}
    return content_hash(content)


def _digests(folder: Path) -> dict[str, str]:
    return {task: digest_of(str(place)) for task, place in expert_folders(folder).items()}


def _experts_files(options: Mapping[str, Any]) -> PolicyFiles:
    folder = _folder(options)
    return PolicyFiles({"folder": folder.resolve()}, all_files(expert_folders(folder).values()))


def _merged_files(options: Mapping[str, Any]) -> PolicyFiles:
    chosen = merged_options(options)
    folder, files = checkpoint_files(chosen.checkpoint)
    if chosen.experts is None:
        return PolicyFiles({"checkpoint": folder}, files)
    files = tuple(dict.fromkeys((*files, *all_files(expert_folders(chosen.experts).values()))))
    return PolicyFiles({"checkpoint": folder, "experts": chosen.experts.resolve()}, files)


EXPERTS = PolicyKind(
    name=EXPERTS_NAME,
    summary="each task's own expert (arXiv 2511.18810)",
    load=_load_experts,
    digest=_experts_digest,
    options={"folder": "folder of expert checkpoints; the one trained on the episode's task acts"},
    files=_experts_files,
)
MERGED = PolicyKind(
    name=MERGED_NAME,
    summary="experts merged into one model, which infers the task (arXiv 2511.18810)",
    load=_load_merged,
    digest=_merged_digest,
    spec=_merged_spec,
    options={
        "checkpoint": "folder or hub id of the merged checkpoint",
        "router": f"who infers the task, by default {ROUTER}; oracle is told",
        "sees_instruction": "whether the router reads the instruction, by default true",
        "recipe": "merge the experts anew like this; the checkpoint then gives its fitted routers only",
        "experts": "folder of the expert checkpoints that the recipe merges",
    },
    files=_merged_files,
)
