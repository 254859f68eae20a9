"""Merges expert checkpoints into one model: reads and checks the experts, and assigns every weight to a part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.policies.mergevla.checkpoints.expert_checkpoint import load_checkpoint, load_tensors, tensors_of
from robogauntlet.policies.mergevla.checkpoints.expert_copies import quantised_copy, restored
from robogauntlet.policies.mergevla.checkpoints.merged_model import MergedWeights, leading
from robogauntlet.policies.mergevla.checkpoints.metadata import CheckpointMetadata, base_folder, locate
from robogauntlet.policies.mergevla.merging.diagnostics import MergeReport, report
from robogauntlet.policies.mergevla.merging.errors import ExpertsDiffer, MergeError
from robogauntlet.policies.mergevla.merging.merge import MergedTaskVectors, check_operator, merge
from robogauntlet.policies.mergevla.merging.parts import TRUNK, check_blocks, is_merged
from robogauntlet.policies.mergevla.merging.quantisation import pack
from robogauntlet.policies.mergevla.merging.recipe import UNMERGED, BackboneRule, MaskRule, Recipe, TrunkRule
from robogauntlet.policies.mergevla.merging.task_vectors import (
    OnDemand,
    TaskVectors,
    Weights,
    check_same_base,
    task_vector,
)
from robogauntlet.policies.mergevla.merging.trunk import mean_trunk, split_trunk
from robogauntlet.policies.mergevla.network.lora import BACKBONE, Factors, lora_factors
from robogauntlet.policies.mergevla.network.normalisation import TaskStatistics

VALUES = "action_expert.blocks.{block}.{path}.weight"


@dataclass(frozen=True, eq=False)
class Expert:
    """One expert as it was trained."""

    task: str
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
    by_task: Mapping[str, Expert]


@dataclass(frozen=True, eq=False)
class Merging:
    """Result of a merge."""

    parts: MergedWeights
    report: MergeReport
    base: Path | str
    """The base's checkpoint."""


def read_experts(references: Iterable[str | Path]) -> Experts:
    """Read the experts to merge, each a folder or a hub id.

    Raises PolicyError for a checkpoint that cannot be used, is no expert of one task, or has another base than the
    first.
    """
    by_task: dict[str, Expert] = {}
    base: Path | str = ""
    base_weights: Weights = {}
    for reference in references:
        folder = locate(str(reference))
        checkpoint = load_checkpoint(folder)
        metadata = checkpoint.metadata
        if metadata.base is None or metadata.base_hash is None or metadata.lora is None:
            raise MergeError(f"'{reference}': expected an expert with adapters on a base, got none")
        if len(metadata.tasks) != 1:
            raise MergeError(f"'{reference}': expected an expert for one task, got {', '.join(metadata.tasks)}")
        task = metadata.tasks[0]
        if task in by_task:
            raise MergeError(f"'{reference}': expected one expert per task, got a second one for {task}")
        if not by_task:
            # A hub id is valid on any machine.
            base = base_folder(folder, metadata.base) if (folder / metadata.base).is_dir() else metadata.base
            base_weights, _ = load_tensors(base)
        hashes = {e.task: e.metadata.base_hash or "" for e in by_task.values()} | {task: metadata.base_hash}
        check_same_base({name: base_hash[:16] for name, base_hash in hashes.items()})
        weights: dict[str, Tensor] = {}
        for name, tensor in tensors_of(checkpoint.model).items():
            if ".lora_" in name:
                continue
            if not name.startswith(BACKBONE):
                weights[name] = tensor
            elif not torch.equal(tensor, base_weights[name]):
                raise ExpertsDiffer(f"expert {task}: expected a backbone tuned by adapters alone, got another {name}")
        by_task[task] = Expert(task, metadata, lora_factors(checkpoint.model), weights)
    if not by_task:
        raise MergeError("expected at least one expert to merge, got none")
    return Experts(base, base_weights, by_task)


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
    kept = {task: dict(head) for task, head in parts.heads.items()}
    for task, adapters in parts.adapters.items():
        kept[task] |= {f"{name}.{side}": getattr(f, side) for name, f in adapters.items() for side in ("a", "b")}
    for task, copy in parts.copies.items():
        kept[task] = pack(copy, recipe.options["bits"])
    first = next(iter(experts.by_task.values())).metadata
    assert first.lora is not None
    diagnostics = report(
        _task_vectors(experts, _splits(experts, recipe)[0], recipe),
        parts.merged,
        generator=torch.Generator().manual_seed(0),
        heads=kept,
        lora_rank=first.lora.rank,
        weights={task: expert.weights for task, expert in experts.by_task.items()},
    )
    return Merging(parts, diagnostics, experts.base)


def merge_parts(experts: Experts, recipe: Recipe, instructions: Mapping[str, str] | None = None) -> MergedWeights:
    """Merge experts without a report; see `merge_experts`."""
    check_operator(recipe.operator, recipe.options)
    check_blocks(recipe.only, next(iter(experts.by_task.values())).metadata.architecture.language.layers)
    known = {task: description.instruction for task, description in task_descriptions().items()}
    known |= dict(instructions or {})
    for task in experts.by_task:
        if task not in known:
            raise MergeError(f"expected an instruction for {task}: no simulator here has the task, and none was given")
    trunks, heads = _splits(experts, recipe)
    task_vectors = _task_vectors(experts, trunks, recipe)
    adapters = {
        task: {name: factors for name, factors in expert.factors.items() if not _is_merged(name, recipe)}
        for task, expert in experts.by_task.items()
    }
    copies = {}
    if recipe.operator == UNMERGED:
        copies = {
            task: quantised_copy(expert.factors, expert.weights, experts.base_weights, recipe.options["bits"])
            for task, expert in experts.by_task.items()
        }
        for task, copy in copies.items():
            adapters[task], heads[task] = restored(copy, experts.base_weights)
    if any(task_vectors.values()):
        merged = merge(task_vectors, recipe, {name: weight.dtype for name, weight in experts.base_weights.items()})
    else:
        merged = MergedTaskVectors(tuple(task_vectors), replace(recipe, masks=MaskRule.NONE, rounds=1), {})
    if recipe.masks is MaskRule.SIGNS:  # bf16, as all that is stored under signs
        heads = {task: {name: weight.bfloat16() for name, weight in head.items()} for task, head in heads.items()}
    first = next(iter(experts.by_task.values()))
    return MergedWeights(
        architecture=first.metadata.architecture,
        statistics=TaskStatistics(
            {task: expert.metadata.statistics.of(task) for task, expert in experts.by_task.items()}
        ),
        instructions={task: known[task] for task in experts.by_task},
        recipe=recipe,
        base=experts.base_weights,
        merged=merged,
        trunk={name: weight.to(experts.base_weights[name].dtype) for name, weight in mean_trunk(trunks).items()}
        if recipe.trunk is TrunkRule.MEAN
        else {},
        adapters=adapters if any(adapters.values()) else {},
        heads=heads,
        subspaces={task: _subspaces(expert, recipe) for task, expert in experts.by_task.items()},
        expert_digests={task: expert.metadata.digest for task, expert in experts.by_task.items()},
        copies=copies,
        action_steps={
            task: steps for task, expert in experts.by_task.items() if (steps := expert.metadata.action_steps)
        },
    )


def _splits(experts: Experts, recipe: Recipe) -> tuple[dict[str, Weights], dict[str, Weights]]:
    """Return the trunk and the head of each task."""
    trunks: dict[str, Weights] = {}
    heads: dict[str, Weights] = {}
    for task, expert in experts.by_task.items():
        trunks[task], heads[task] = split_trunk(expert.weights, recipe.kept_blocks, merge_output=recipe.merge_output)
        if recipe.only and TRUNK not in recipe.only:
            trunks[task], heads[task] = {}, expert.weights
    return trunks, heads


def _is_merged(weight: str, recipe: Recipe) -> bool:
    """Whether a weight of the backbone is merged."""
    return recipe.operator != UNMERGED and recipe.backbone is BackboneRule.MERGED and is_merged(weight, recipe.only)


def _task_vectors(experts: Experts, trunks: Mapping[str, Weights], recipe: Recipe) -> TaskVectors:
    """Return the task vectors of the parts that the recipe merges by its operator: backbone, trunk or both.

    A weight that another expert has adapted and this one has not has a task vector of zeros.
    """
    if recipe.operator == UNMERGED:
        return {task: {} for task in experts.by_task}
    adapted = {name for expert in experts.by_task.values() for name in expert.factors}
    task_vectors = {}
    for task, expert in experts.by_task.items():
        makers: dict[str, Callable[[], Tensor]] = {
            name: factors.delta if (factors := expert.factors.get(name)) else partial(torch.zeros, weight.shape)
            for name, weight in experts.base_weights.items()
            if name in adapted and _is_merged(name, recipe)
        }
        if recipe.trunk is TrunkRule.VECTORS:
            trunk = task_vector(trunks[task], {name: experts.base_weights[name] for name in trunks[task]})
            makers |= {name: partial(trunk.__getitem__, name) for name in trunk}
        task_vectors[task] = OnDemand(makers)
    return task_vectors


def _subspaces(expert: Expert, recipe: Recipe) -> tuple[Tensor, Tensor]:
    """Subspaces of block L - k - 1 from 0, the last that is merged; of the first if all blocks are kept."""
    block = max(expert.metadata.architecture.language.layers - recipe.kept_blocks - 1, 0)
    adapter, task = (leading(expert.weights[VALUES.format(block=block, path=path)]) for path in ("v_adapter", "v_task"))
    return adapter, task
