"""MergeVLA's policy kinds: one network, one expert per task, merged experts. Light: torch is imported at loading."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from robogauntlet.adapters.catalog import original
from robogauntlet.policies.contract import Policy, PolicyFiles, PolicyKind, PolicySpec
from robogauntlet.suites.episode import content_hash
from robogauntlet_mergevla.checkpoints.merged_metadata import KIND as MERGED_KIND, MergedMetadata, merged_digest_of
from robogauntlet_mergevla.checkpoints.metadata import (
    METADATA_FILE,
    CheckpointMetadata,
    all_files,
    checkpoint_files,
    digest_of,
    locate,
    read_metadata_file,
)
from robogauntlet_mergevla.options import (
    CPU,
    DEVICE_MEANING,
    EXPERTS_NAME,
    MERGED_NAME,
    NAME,
    ROUTER,
    check_packages,
    device_option,
    expert_folders,
    merged_options,
    needs_packages,
    text_option,
)
from robogauntlet_mergevla.spec import UNFITTED_ROUTERS, experts_spec, merged_spec
from robogauntlet_mergevla.zoo import SCHEME, shipped


def _named(text: str) -> tuple[str, dict[str, str]] | None:
    """The kind and the options of the policy that a text names, if it is a checkpoint or a folder of experts."""
    folder = shipped(text)
    if (folder / METADATA_FILE).is_file():
        merged = read_metadata_file(folder).get("kind") == MERGED_KIND
        return (MERGED_NAME if merged else NAME), {"checkpoint": text}
    return (EXPERTS_NAME, {"folder": text}) if any(folder.glob(f"*/{METADATA_FILE}")) else None


def _named_as(kind: str) -> Callable[[str], Mapping[str, str] | None]:
    def named(text: str) -> Mapping[str, str] | None:
        found = _named(text)
        return found[1] if found is not None and found[0] == kind else None

    return named


def _checkpoint(options: Mapping[str, Any]) -> str:
    return text_option(NAME, options, "checkpoint", "a folder or hub id")


def _arithmetic(device: str) -> dict[str, str]:
    """What a device adds to the content of a policy: a GPU rounds differently, so it gives other actions."""
    return {} if device == CPU else {"device": device.partition(":")[0]}


def _digest(options: Mapping[str, Any]) -> str:
    arithmetic, digest = _arithmetic(device_option(NAME, options)), digest_of(_checkpoint(options))
    return content_hash({"policy": digest, **arithmetic}) if arithmetic else digest


def _load(options: Mapping[str, Any]) -> Policy:
    reference, device = _checkpoint(options), device_option(NAME, options)
    with needs_packages(NAME):
        from robogauntlet_mergevla.policies.single_policy import MergeVLAPolicy
    return MergeVLAPolicy(locate(reference), device=device)


def _files(options: Mapping[str, Any]) -> PolicyFiles:
    folder, files = checkpoint_files(_checkpoint(options))
    return PolicyFiles({"checkpoint": folder}, files)


def _folder(options: Mapping[str, Any]) -> Path:
    return shipped(text_option(EXPERTS_NAME, options, "folder", "a folder of expert checkpoints"))


def _digests(folder: Path) -> dict[str, str]:
    return {task: digest_of(str(path)) for task, path in expert_folders(folder).items()}


def _load_experts(options: Mapping[str, Any]) -> Policy:
    folders, device = expert_folders(_folder(options)), device_option(EXPERTS_NAME, options)
    with needs_packages(EXPERTS_NAME):
        from robogauntlet_mergevla.policies.single_policy import MergeVLAPolicy
    return MergeVLAPolicy(folders, device=device)


def _experts_spec(options: Mapping[str, Any]) -> PolicySpec:
    check_packages(EXPERTS_NAME)
    return experts_spec(
        {task: CheckpointMetadata.read(path) for task, path in expert_folders(_folder(options)).items()}
    )


def _experts_digest(options: Mapping[str, Any]) -> str:
    arithmetic = _arithmetic(device_option(EXPERTS_NAME, options))
    return content_hash({"policy": EXPERTS_NAME, "experts": _digests(_folder(options)), **arithmetic})


def _expert_digest(options: Mapping[str, Any], task: str) -> str:
    return digest_of(str(expert_folders(_folder(options))[original(task)]))


def _experts_files(options: Mapping[str, Any]) -> PolicyFiles:
    folder = _folder(options)
    return PolicyFiles({"folder": folder.resolve()}, all_files(expert_folders(folder).values()))


def _load_merged(options: Mapping[str, Any]) -> Policy:
    chosen = merged_options(options)
    with needs_packages(MERGED_NAME):
        from robogauntlet_mergevla.policies.merged_policy import MergedPolicy
    return MergedPolicy.of(chosen)


def _merged_spec(options: Mapping[str, Any]) -> PolicySpec:
    chosen = merged_options(options)
    check_packages(MERGED_NAME)
    if chosen.checkpoint.startswith(SCHEME) and chosen.recipe is None:  # a checkpoint of others is loaded, to check it
        metadata = MergedMetadata.read(locate(chosen.checkpoint))
        if chosen.router in (*UNFITTED_ROUTERS, *metadata.routers):
            return merged_spec(
                metadata.architecture, metadata.statistics.action_dims, metadata.instructions, chosen.router
            )
    with needs_packages(MERGED_NAME):
        from robogauntlet_mergevla.policies.merged_policy import checked_spec
    return checked_spec(chosen)


def _merged_digest(options: Mapping[str, Any]) -> str:
    chosen = merged_options(options)
    content = {
        "policy": MERGED_NAME,
        "model": merged_digest_of(chosen.checkpoint),
        "router": chosen.router,
        "sees_instruction": chosen.sees_instruction,
        **_arithmetic(chosen.device),
    }
    if not chosen.expert_sees_instruction:
        content["expert_sees_instruction"] = False
    if chosen.recipe is not None and chosen.experts is not None:
        content |= {"recipe": chosen.recipe.as_json(), "experts": _digests(chosen.experts)}
    return content_hash(content)


def _merged_files(options: Mapping[str, Any]) -> PolicyFiles:
    chosen = merged_options(options)
    folder, files = checkpoint_files(chosen.checkpoint)
    if chosen.experts is None:
        return PolicyFiles({"checkpoint": folder}, files)
    files = tuple(dict.fromkeys((*files, *all_files(expert_folders(chosen.experts).values()))))
    return PolicyFiles({"checkpoint": folder, "experts": chosen.experts.resolve()}, files)


KIND = PolicyKind(
    name=NAME,
    summary="a vision-language-action network from a checkpoint (arXiv 2511.18810)",
    load=_load,
    digest=_digest,
    spec=lambda options: _load({**options, "device": CPU}).spec,
    options={"checkpoint": "folder or hub id of the checkpoint", "device": DEVICE_MEANING},
    files=_files,
    named=_named_as(NAME),
)
EXPERTS = PolicyKind(
    name=EXPERTS_NAME,
    summary="each task's own expert (arXiv 2511.18810)",
    load=_load_experts,
    digest=_experts_digest,
    spec=_experts_spec,
    options={
        "folder": "folder of expert checkpoints; the one trained on the episode's task acts",
        "device": DEVICE_MEANING,
    },
    files=_experts_files,
    named=_named_as(EXPERTS_NAME),
    digest_in=_expert_digest,
)
MERGED = PolicyKind(
    name=MERGED_NAME,
    summary="experts merged into one model, which infers the task (arXiv 2511.18810)",
    load=_load_merged,
    digest=_merged_digest,
    spec=_merged_spec,
    options={
        "checkpoint": "folder or hub id of the merged checkpoint",
        "router": f"the router, which infers the task, by default {ROUTER}; `oracle` is given the true task",
        "sees_instruction": "whether the router reads the instruction, by default true",
        "expert_sees_instruction": "whether the expert that acts reads the instruction, by default true; otherwise it "
        "is told the one of the task that the router inferred",
        "recipe": "how to merge the experts at loading; the checkpoint then provides its fitted routers only",
        "experts": "folder of the expert checkpoints that the recipe merges",
        "device": DEVICE_MEANING,
    },
    files=_merged_files,
    named=_named_as(MERGED_NAME),
)
