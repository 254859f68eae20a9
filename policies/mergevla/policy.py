"""MergeVLA as a kind of policy. Light: torch is imported when a policy is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from policies.contract import Policy, PolicyError, PolicyFiles, PolicyKind
from policies.mergevla.card import digest_of
from policies.mergevla.files import checkpoint_files


def _checkpoint(options: Mapping[str, Any]) -> str:
    reference = options.get("checkpoint")
    if not isinstance(reference, str) or not reference:
        raise PolicyError(f"policy 'mergevla': expected option checkpoint: a folder or hub id, got {reference!r}")
    return reference


def _load(options: Mapping[str, Any]) -> Policy:
    reference = _checkpoint(options)
    try:
        from policies.mergevla.acting import MergeVLAPolicy
    except ModuleNotFoundError as error:
        raise PolicyError(
            f"policy 'mergevla': expected the packages of robogauntlet[mergevla], found none named {error.name}"
        ) from None
    return MergeVLAPolicy.from_checkpoint(reference)


def _files(options: Mapping[str, Any]) -> PolicyFiles:
    folder, files = checkpoint_files(_checkpoint(options))
    return PolicyFiles({"checkpoint": folder}, files)


KIND = PolicyKind(
    name="mergevla",
    summary="a vision-language-action network from a checkpoint (arXiv 2511.18810)",
    load=_load,
    digest=lambda options: digest_of(_checkpoint(options)),
    options={"checkpoint": "folder or hub id of the checkpoint"},
    files=_files,
)
