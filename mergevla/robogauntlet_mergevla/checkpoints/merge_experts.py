"""Merges expert checkpoints into one model: reads and checks the experts, and assigns every weight to a part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path

import torch
from torch import Tensor

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_tensors, load_verified
from robogauntlet_mergevla.checkpoints.expert_copies import Copy, quantised_copy, restored
from robogauntlet_mergevla.checkpoints.merged_model import MergedWeights, leading
from robogauntlet_mergevla.checkpoints.metadata import (
    CheckpointError,
    CheckpointMetadata,
    base_folder,
    locate,
)
from robogauntlet_mergevla.merging.diagnostics import MergeReport, report
from robogauntlet_mergevla.merging.errors import ExpertsDiffer, MergeError
from robogauntlet_mergevla.merging.merge import MergedTaskVectors, check_operator, merge
from robogauntlet_mergevla.merging.parts import TRUNK, check_blocks, is_merged
from robogauntlet_mergevla.merging.quantisation import pack
from robogauntlet_mergevla.merging.recipe import UNMERGED, BackboneRule, MaskRule, Recipe, TrunkRule
from robogauntlet_mergevla.merging.task_vectors import (
    OnDemand,
    TaskVectors,
    Weights,
    check_same_base,
    task_vector,
)
from robogauntlet_mergevla.merging.trunk import mean_trunk, split_trunk
from robogauntlet_mergevla.network.lora import BACKBONE, Factors, lora_factors
from robogauntlet_mergevla.network.normalisation import TaskStatistics
from robogauntlet_mergevla.zoo import shipped

VALUES = "action_expert.blocks.{block}.{path}.weight"


@dataclass(frozen=True, eq=False)
class Expert:
    """One expert as it was trained."""

    metadata: CheckpointMetadata
    factors: Mapping[str, Factors]
    """Weight of the backbone to its adapter."""
    weights: Weights
    """All other trained weights: action queries, proprioception, action expert."""


@dataclass(frozen=True, eq=False)
class Experts:
    """Experts of one base."""

    base: Path | str
    """The base's checkpoint."""
    base_weights: Weights
    by_name: Mapping[str, Expert]
    checkpoints: Mapping[str, Path | str]
    """Expert to its checkpoint, a folder or a hub id."""

    @property
    def tasks(self) -> dict[str, tuple[str, ...]]:
        """Expert to its tasks."""
        return {name: expert.metadata.tasks for name, expert in self.by_name.items()}


@dataclass(frozen=True, eq=False)
class Merging:
    """Result of a merge."""

    parts: MergedWeights
    report: MergeReport
    base: Path | str
    """The base's checkpoint."""
    checkpoints: Mapping[str, Path | str] = field(default_factory=dict)
    """Expert to its checkpoint."""


def read_experts(references: Iterable[str | Path]) -> Experts:
    """Read the experts to merge, each a folder or a hub id.

    Raises PolicyError for a checkpoint that cannot be used, is no expert, shares a task with another, or has another
    base than the first.
    """
    by_name: dict[str, Expert] = {}
    checkpoints: dict[str, Path | str] = {}
    of_task: dict[str, str] = {}
    base: Path | str = ""
    base_weights: Weights = {}
    for reference in references:
        folder = locate(str(reference))
        tensors, metadata = load_verified(folder)
        try:
            name = metadata.expert
        except CheckpointError as error:
            raise MergeError(f"'{reference}': {error}") from None
        for task in metadata.tasks:
            if task in of_task:
                raise MergeError(f"'{reference}': expected one expert per task, got a second one for {task}")
            of_task[task] = name
        if name in by_name:
            raise MergeError(f"'{reference}': expected experts of different names, got a second '{name}'")
        if not by_name:
            own = metadata.base or ""
            # A hub id is valid on any machine.
            base = base_folder(folder, own) if (folder / own).is_dir() else own
            base_weights, _ = load_tensors(base)
        hashes = {other: expert.metadata.base_hash for other, expert in by_name.items()} | {name: metadata.base_hash}
        check_same_base({other: (base_hash or "")[:16] for other, base_hash in hashes.items()})
        weights: dict[str, Tensor] = {}
        for weight, tensor in tensors.items():
            if ".lora_" in weight:
                continue
            if not weight.startswith(BACKBONE):
                weights[weight] = tensor
            elif not torch.equal(tensor, base_weights[weight]):
                raise ExpertsDiffer(f"expert {name}: expected a backbone tuned by adapters alone, got another {weight}")
        factors = lora_factors(tensors, metadata.lora) if metadata.lora is not None else {}
        by_name[name] = Expert(metadata, factors, weights)
        checkpoints[name] = folder if shipped(str(reference)).is_dir() else str(reference)
    if not by_name:
        raise MergeError("expected at least one expert to merge, got none")
    return Experts(base, base_weights, by_name, checkpoints)


def merge_experts(experts: Experts, recipe: Recipe, instructions: Mapping[str, str] | None = None) -> Merging:
    """Merge experts and report on the merge.

    Args:
        experts: See `read_experts`.
        recipe: Recipe of the merge.
        instructions: Task to instruction; by default the simulators' own.

    Raises:
        PolicyError: The experts do not fit each other or the recipe, or a task has no instruction.
    """
    parts = merge_parts(experts, recipe, instructions)
    kept = {name: dict(head) for name, head in parts.heads.items()}
    for name, adapters in parts.adapters.items():
        kept[name] |= {f"{weight}.{side}": getattr(f, side) for weight, f in adapters.items() for side in ("a", "b")}
    for name, copy in parts.copies.items():
        assert recipe.stored_bits is not None
        kept[name] = pack(copy, recipe.stored_bits)
    first = next(iter(experts.by_name.values())).metadata
    assert first.lora is not None
    diagnostics = report(
        _task_vectors(experts, _splits(experts, recipe)[0], recipe),
        parts.merged,
        generator=torch.Generator().manual_seed(0),
        heads=kept,
        lora_rank=first.lora.rank,
        weights={name: expert.weights for name, expert in experts.by_name.items()},
    )
    return Merging(parts, diagnostics, experts.base, experts.checkpoints)


def merge_parts(experts: Experts, recipe: Recipe, instructions: Mapping[str, str] | None = None) -> MergedWeights:
    """Merge experts without a report; see `merge_experts`."""
    check_operator(recipe.operator, recipe.options)
    first = next(iter(experts.by_name.values())).metadata
    check_blocks(recipe.only, first.architecture.language.layers)
    known, declared = dict(instructions or {}), task_descriptions()
    for task in chain.from_iterable(experts.tasks.values()):
        if task not in known and task in declared:
            known[task] = declared[task].instruction
        if task not in known:
            raise MergeError(f"expected an instruction for {task}: no simulator here has the task, and none was given")
    trunks, heads = _splits(experts, recipe)
    task_vectors = _task_vectors(experts, trunks, recipe)
    adapters = {
        name: {weight: factors for weight, factors in expert.factors.items() if not _is_merged(weight, recipe)}
        for name, expert in experts.by_name.items()
    }
    mean = mean_trunk(trunks) if recipe.trunk is TrunkRule.MEAN else {}
    copies: dict[str, Copy] = {}
    trunk_copy: Copy = {}
    if (bits := recipe.stored_bits) is not None:
        if recipe.operator == UNMERGED:
            heads = {name: expert.weights for name, expert in experts.by_name.items()}
        for name in experts.by_name:
            copies[name] = quantised_copy(adapters[name], heads[name], experts.base_weights, bits)
            adapters[name], heads[name] = restored(copies[name], experts.base_weights)
        trunk_copy = quantised_copy({}, mean, experts.base_weights, bits)
        _, mean = restored(trunk_copy, experts.base_weights)
    if any(task_vectors.values()):
        merged = merge(task_vectors, recipe, {name: weight.dtype for name, weight in experts.base_weights.items()})
    else:
        merged = MergedTaskVectors(tuple(task_vectors), replace(recipe, masks=MaskRule.NONE, rounds=1), {})
    if recipe.masks is MaskRule.SIGNS and not copies:  # bf16, as all that is stored under signs
        heads = {name: {key: weight.bfloat16() for key, weight in head.items()} for name, head in heads.items()}
    return MergedWeights(
        architecture=first.architecture,
        statistics=TaskStatistics(
            {name: expert.metadata.statistics.of(name) for name, expert in experts.by_name.items()}
        ),
        tasks=experts.tasks,
        instructions={task: known[task] for task in chain.from_iterable(experts.tasks.values())},
        recipe=recipe,
        base=experts.base_weights,
        merged=merged,
        trunk={name: weight.to(experts.base_weights[name].dtype) for name, weight in mean.items()},
        adapters=adapters if any(adapters.values()) else {},
        heads=heads,
        subspaces={name: _subspaces(expert, recipe) for name, expert in experts.by_name.items()},
        expert_digests={name: expert.metadata.digest for name, expert in experts.by_name.items()},
        copies=copies,
        trunk_copy=trunk_copy,
        action_steps={
            name: steps for name, expert in experts.by_name.items() if (steps := expert.metadata.action_steps)
        },
    )


def _splits(experts: Experts, recipe: Recipe) -> tuple[dict[str, Weights], dict[str, Weights]]:
    """Return the trunk and the head of each expert."""
    trunks: dict[str, Weights] = {}
    heads: dict[str, Weights] = {}
    for name, expert in experts.by_name.items():
        trunks[name], heads[name] = split_trunk(expert.weights, recipe.kept_blocks, merge_output=recipe.merge_output)
        if recipe.only and TRUNK not in recipe.only:
            trunks[name], heads[name] = {}, expert.weights
    return trunks, heads


def _is_merged(weight: str, recipe: Recipe) -> bool:
    """Whether a weight of the backbone is merged."""
    return recipe.operator != UNMERGED and recipe.backbone is BackboneRule.MERGED and is_merged(weight, recipe.only)


def _task_vectors(experts: Experts, trunks: Mapping[str, Weights], recipe: Recipe) -> TaskVectors:
    """Return the task vectors of the parts that the recipe merges by its operator: backbone, trunk or both.

    A weight that another expert has adapted and this one has not has a task vector of zeros.
    """
    if recipe.operator == UNMERGED:
        return {name: {} for name in experts.by_name}
    adapted = {key for expert in experts.by_name.values() for key in expert.factors}
    task_vectors = {}
    for name, expert in experts.by_name.items():
        makers: dict[str, Callable[[], Tensor]] = {
            key: factors.delta if (factors := expert.factors.get(key)) else partial(torch.zeros, weight.shape)
            for key, weight in experts.base_weights.items()
            if key in adapted and _is_merged(key, recipe)
        }
        if recipe.trunk is TrunkRule.VECTORS:
            trunk = task_vector(trunks[name], {key: experts.base_weights[key] for key in trunks[name]})
            makers |= {key: partial(trunk.__getitem__, key) for key in trunk}
        task_vectors[name] = OnDemand(makers)
    return task_vectors


def _subspaces(expert: Expert, recipe: Recipe) -> tuple[Tensor, Tensor]:
    """Subspaces of block L - k - 1 from 0, the last that is merged; of the first if all blocks are kept."""
    block = max(expert.metadata.architecture.language.layers - recipe.kept_blocks - 1, 0)
    adapter, task = (leading(expert.weights[VALUES.format(block=block, path=path)]) for path in ("v_adapter", "v_task"))
    return adapter, task
