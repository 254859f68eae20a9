"""Experts and merged models as kinds of policies. Light: torch is imported when a policy is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from policies.contract import Policy, PolicyError, PolicyKind
from policies.mergevla.card import CARD, CheckpointError, card_json, digest_of, read_card
from policies.mergevla.merged_card import KIND, merged_digest_of
from policies.zoo import shipped
from suites.vocabulary import content_hash

EXPERTS_NAME, MERGED_NAME = "mergevla-experts", "mergevla-merged"
ROUTER = "calibrated"
"""The router of a merged policy that names none."""


def expert_folders(folder: Path) -> dict[str, Path]:
    """The experts in a folder of checkpoints: task to the folder of the one that was trained on it.

    What stands alone (a base) or is merged is left out.

    Raises:
        PolicyError: There is no expert, one that was trained on several tasks, or a second one for a task.
    """
    if not folder.is_dir():
        raise CheckpointError(f"expected a folder of expert checkpoints, got '{folder}'")
    found: dict[str, Path] = {}
    for place in sorted(path.parent for path in folder.glob(f"*/{CARD}")):
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


def _merged(options: Mapping[str, Any]) -> tuple[str, str, bool]:
    """Checkpoint, router, and whether the router sees the instruction."""
    checkpoint = _option(MERGED_NAME, options, "checkpoint", "a folder or hub id")
    router = _option(MERGED_NAME, {"router": ROUTER, **options}, "router", "a router's name")
    sees = options.get("sees_instruction", True)
    if not isinstance(sees, bool):
        raise PolicyError(f"policy '{MERGED_NAME}': expected option sees_instruction: true or false, got {sees!r}")
    return checkpoint, router, sees


def _load_experts(options: Mapping[str, Any]) -> Policy:
    folders = expert_folders(_folder(options))
    try:
        from policies.mergevla.acting_merged import ExpertsPolicy
    except ModuleNotFoundError as error:
        raise _not_installed(EXPERTS_NAME, error) from None
    return ExpertsPolicy(folders)


def _load_merged(options: Mapping[str, Any]) -> Policy:
    checkpoint, router, sees = _merged(options)
    try:
        from policies.mergevla.acting_merged import MergedPolicy
    except ModuleNotFoundError as error:
        raise _not_installed(MERGED_NAME, error) from None
    return MergedPolicy.from_checkpoint(checkpoint, router, sees_instruction=sees)


def _not_installed(name: str, error: ModuleNotFoundError) -> PolicyError:
    return PolicyError(
        f"policy '{name}': expected the packages of robogauntlet[mergevla], found none named {error.name}"
    )


def _experts_digest(options: Mapping[str, Any]) -> str:
    digests = {task: digest_of(str(place)) for task, place in expert_folders(_folder(options)).items()}
    return content_hash({"policy": EXPERTS_NAME, "experts": digests})


def _merged_digest(options: Mapping[str, Any]) -> str:
    checkpoint, router, sees = _merged(options)
    model = merged_digest_of(checkpoint)
    return content_hash({"policy": MERGED_NAME, "model": model, "router": router, "sees_instruction": sees})


EXPERTS = PolicyKind(
    name=EXPERTS_NAME,
    summary="each task's own expert (arXiv 2511.18810)",
    load=_load_experts,
    digest=_experts_digest,
    options={"folder": "folder of expert checkpoints; the one trained on the episode's task acts"},
)
MERGED = PolicyKind(
    name=MERGED_NAME,
    summary="experts merged into one model, which infers the task (arXiv 2511.18810)",
    load=_load_merged,
    digest=_merged_digest,
    options={
        "checkpoint": "folder or hub id of the merged checkpoint",
        "router": f"who infers the task, by default {ROUTER}; oracle is told",
        "sees_instruction": "whether the router reads the instruction, by default true",
    },
)
