"""From expert checkpoints to a merged model: what is read, what is refused, and which weight goes where."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.policies.mergevla.checkpoints.expert_checkpoint import load_checkpoint, load_tensors, tensors_of
from robogauntlet.policies.mergevla.checkpoints.merged_model import MergedWeights, leading
from robogauntlet.policies.mergevla.checkpoints.metadata import CheckpointMetadata, base_folder, locate
from robogauntlet.policies.mergevla.merging.diagnostics import MergeReport, report
from robogauntlet.policies.mergevla.merging.errors import ExpertsDiffer, MergeError
from robogauntlet.policies.mergevla.merging.merge import MergedTaskVectors, merge
from robogauntlet.policies.mergevla.merging.operators import find_operator
from robogauntlet.policies.mergevla.merging.recipe import BackboneRule, MaskRule, Recipe, TrunkRule
from robogauntlet.policies.mergevla.merging.task_vectors import TaskVectors, Weights, check_same_base, task_vector
from robogauntlet.policies.mergevla.merging.trunk import TrunkSplit, mean_trunk, split_trunk
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
    """All else that was trained: action queries, proprioception, action expert."""


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
    """Read the experts that are to be merged.

    Args:
        references: Folders or hub ids.

    Raises:
        PolicyError: A checkpoint that cannot be used, is no expert of one task, or is of another base than the first.
    """
    found: dict[str, Expert] = {}
    base: Path | str = ""
    base_weights: Weights = {}
    for reference in references:
        folder = locate(str(reference))
        checkpoint = load_checkpoint(folder)
        metadata = checkpoint.metadata
        if metadata.base is None or metadata.base_hash is None or metadata.lora is None:
            raise MergeError(f"'{reference}': expected an expert with adapters on a base, got one that stands alone")
        if len(metadata.tasks) != 1:
            raise MergeError(f"'{reference}': expected an expert for one task, got {', '.join(metadata.tasks)}")
        task = metadata.tasks[0]
        if task in found:
            raise MergeError(f"'{reference}': expected one expert per task, got a second one for {task}")
        if not found:
            base = _found_base(folder, metadata.base)
            base_weights, _ = load_tensors(base)
        check_same_base({e.task: _short(e.metadata) for e in found.values()} | {task: _short(metadata)})
        tensors = {name: tensor for name, tensor in tensors_of(checkpoint.model).items() if ".lora_" not in name}
        _check_frozen(task, tensors, base_weights)
        own = {name: tensor for name, tensor in tensors.items() if not name.startswith(BACKBONE)}
        found[task] = Expert(task, metadata, lora_factors(checkpoint.model), own)
    if not found:
        raise MergeError("expected at least one expert to merge, got none")
    return Experts(base, base_weights, found)


def merge_experts(experts: Experts, recipe: Recipe, instructions: Mapping[str, str] | None = None) -> Merging:
    """Merge experts.

    Args:
        experts: See `read_experts`.
        recipe: How.
        instructions: Task to instruction; by default the simulators' own.

    Raises:
        PolicyError: The experts do not fit each other or the recipe, or a task has no instruction.
    """
    parts = merge_parts(experts, recipe, instructions)
    kept = {task: {**head, **_stored(parts.adapters.get(task, {}))} for task, head in parts.heads.items()}
    first = next(iter(experts.by_task.values())).metadata
    assert first.lora is not None
    made = report(
        _task_vectors(experts, _splits(experts, recipe), recipe),
        parts.merged,
        generator=torch.Generator().manual_seed(0),
        heads=kept,
        lora_rank=first.lora.rank,
        weights={task: expert.weights for task, expert in experts.by_task.items()},
    )
    return Merging(parts, made, experts.base)


def merge_parts(experts: Experts, recipe: Recipe, instructions: Mapping[str, str] | None = None) -> MergedWeights:
    """Merge experts without reporting on it; see `merge_experts`."""
    find_operator(recipe.operator)
    splits = _splits(experts, recipe)
    task_vectors = _task_vectors(experts, splits, recipe)
    trunks = {task: split.shared for task, split in splits.items()}
    selects = recipe.backbone is BackboneRule.SELECT
    first = next(iter(experts.by_task.values()))
    return MergedWeights(
        architecture=first.metadata.architecture,
        statistics=TaskStatistics(
            {task: expert.metadata.statistics.of(task) for task, expert in experts.by_task.items()}
        ),
        instructions=_instructions(tuple(experts.by_task), instructions),
        recipe=recipe,
        base=experts.base_weights,
        merged=_merged(task_vectors, recipe),
        trunk=mean_trunk(trunks) if recipe.trunk is TrunkRule.MEAN else {},
        adapters={task: expert.factors for task, expert in experts.by_task.items()} if selects else {},
        heads={task: _head(split.kept, recipe) for task, split in splits.items()},
        subspaces={task: _subspaces(expert, recipe) for task, expert in experts.by_task.items()},
        expert_digests={task: expert.metadata.digest for task, expert in experts.by_task.items()},
        action_steps={
            task: steps for task, expert in experts.by_task.items() if (steps := expert.metadata.action_steps)
        },
    )


def _splits(experts: Experts, recipe: Recipe) -> dict[str, TrunkSplit]:
    return {
        task: split_trunk(expert.weights, recipe.kept_blocks, merge_output=recipe.merge_output)
        for task, expert in experts.by_task.items()
    }


def _head(kept: Weights, recipe: Recipe) -> Weights:
    """What a task keeps for itself; under signs in bf16, as all that is stored there."""
    return {name: weight.bfloat16() for name, weight in kept.items()} if recipe.masks is MaskRule.SIGNS else kept


def _found_base(folder: Path, base: str) -> Path | str:
    """Return the base's folder if it is local, else its hub id, which is valid on any machine."""
    return base_folder(folder, base) if (folder / base).is_dir() else base


def _check_frozen(task: str, tensors: Weights, base: Weights) -> None:
    for name, tensor in tensors.items():
        if name.startswith(BACKBONE) and not torch.equal(tensor, base[name]):
            raise ExpertsDiffer(f"expert {task}: expected a backbone tuned by adapters alone, got another {name}")


def _task_vectors(experts: Experts, splits: Mapping[str, TrunkSplit], recipe: Recipe) -> TaskVectors:
    """Return the task vectors of the parts that the recipe merges by its operator: backbone, trunk or both.

    A weight that another expert has adapted and this one has not has a task vector of zeros.
    """
    task_vectors: dict[str, dict[str, Tensor]] = {task: {} for task in experts.by_task}
    adapted = {name for expert in experts.by_task.values() for name in expert.factors}
    for task, expert in experts.by_task.items():
        if recipe.backbone is BackboneRule.MERGED:
            task_vectors[task] |= {
                name: factors.delta() if (factors := expert.factors.get(name)) else torch.zeros(weight.shape)
                for name, weight in experts.base_weights.items()
                if name in adapted
            }
        if recipe.trunk is TrunkRule.VECTORS:
            shared = splits[task].shared
            task_vectors[task] |= task_vector(shared, {name: experts.base_weights[name] for name in shared})
    return task_vectors


def _merged(task_vectors: TaskVectors, recipe: Recipe) -> MergedTaskVectors:
    if not any(task_vectors.values()):
        return MergedTaskVectors(tuple(task_vectors), replace(recipe, masks=MaskRule.NONE, rounds=1), {})
    return merge(task_vectors, recipe)


def _instructions(tasks: Sequence[str], given: Mapping[str, str] | None) -> dict[str, str]:
    known = {task: description.instruction for task, description in task_descriptions().items()} | dict(given or {})
    for task in tasks:
        if task not in known:
            raise MergeError(f"expected an instruction for {task}: no simulator here has the task, and none was given")
    return {task: known[task] for task in tasks}


def _subspaces(expert: Expert, recipe: Recipe) -> tuple[Tensor, Tensor]:
    """Of block L - k - 1 from 0, the last that is merged; of the first if all blocks are kept."""
    block = max(expert.metadata.architecture.language.layers - recipe.kept_blocks - 1, 0)
    adapter, task = (leading(expert.weights[VALUES.format(block=block, path=path)]) for path in ("v_adapter", "v_task"))
    return adapter, task


def _stored(factors: Mapping[str, Factors]) -> dict[str, Tensor]:
    """Adapters as weights, for counting bytes."""
    return {f"{name}.{part}": getattr(f, part) for name, f in factors.items() for part in ("a", "b")}


def _short(metadata: CheckpointMetadata) -> str:
    return (metadata.base_hash or "")[:16]
