"""From expert checkpoints to a merged model: what is read, what is refused, and which weight goes where."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from adapters.catalog import task_cards
from policies.mergevla.card import Card, base_folder, locate
from policies.mergevla.checkpoint import load_checkpoint, load_tensors, tensors_of
from policies.mergevla.lora import BACKBONE, Factors, lora_factors
from policies.mergevla.merged_model import Parts, leading
from policies.mergevla.merging.diagnostics import MergeReport, report
from policies.mergevla.merging.errors import ExpertsDiffer, MergeError
from policies.mergevla.merging.merged import MergedTau, merge
from policies.mergevla.merging.operators import find_operator
from policies.mergevla.merging.recipe import BackboneRule, MaskRule, Recipe, TrunkRule
from policies.mergevla.merging.taus import Taus, Weights, check_same_base, task_vector
from policies.mergevla.merging.trunk import TrunkSplit, mean_trunk, split_trunk
from policies.mergevla.normalisation import TaskStatistics

BLOCKS = r"action_expert\.blocks\.(\d+)\."
OUTPUT = r"action_expert\.output"
"""The action expert's last LayerNorm and its output projection, not a block's own output projection."""
VALUES = "action_expert.blocks.{block}.{path}.weight"


@dataclass(frozen=True, eq=False)
class Expert:
    """One expert as it was trained."""

    task: str
    card: Card
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
    """What came of a merge."""

    parts: Parts
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
        card = checkpoint.card
        if card.base is None or card.base_hash is None or card.lora is None:
            raise MergeError(f"'{reference}': expected an expert with adapters on a base, got one that stands alone")
        if len(card.tasks) != 1:
            raise MergeError(f"'{reference}': expected an expert for one task, got {', '.join(card.tasks)}")
        task = card.tasks[0]
        if task in found:
            raise MergeError(f"'{reference}': expected one expert per task, got a second one for {task}")
        if not found:
            base = _found_base(folder, card.base)
            base_weights, _ = load_tensors(base)
        check_same_base({e.task: _short(e.card) for e in found.values()} | {task: _short(card)})
        tensors = {name: tensor for name, tensor in tensors_of(checkpoint.model).items() if ".lora_" not in name}
        _check_frozen(task, tensors, base_weights)
        own = {name: tensor for name, tensor in tensors.items() if not name.startswith(BACKBONE)}
        found[task] = Expert(task, card, lora_factors(checkpoint.model), own)
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
    first = next(iter(experts.by_task.values())).card
    assert first.lora is not None
    made = report(
        _task_vectors(experts, _splits(experts, recipe), recipe),
        parts.merged,
        generator=torch.Generator().manual_seed(0),
        heads=kept,
        lora_rank=first.lora.rank,
        blocks={"action_expert": ({task: expert.weights for task, expert in experts.by_task.items()}, BLOCKS)},
    )
    return Merging(parts, made, experts.base)


def merge_parts(experts: Experts, recipe: Recipe, instructions: Mapping[str, str] | None = None) -> Parts:
    """Merge experts without reporting on it; see `merge_experts`."""
    find_operator(recipe.operator)
    splits = _splits(experts, recipe)
    taus = _task_vectors(experts, splits, recipe)
    trunks = {task: split.shared for task, split in splits.items()}
    selects = recipe.backbone is BackboneRule.SELECT
    first = next(iter(experts.by_task.values()))
    return Parts(
        architecture=first.card.architecture,
        statistics=TaskStatistics({task: expert.card.statistics.of(task) for task, expert in experts.by_task.items()}),
        instructions=_instructions(tuple(experts.by_task), instructions),
        recipe=recipe,
        base=experts.base_weights,
        merged=_merged(taus, recipe),
        trunk=mean_trunk(trunks) if recipe.trunk is TrunkRule.MEAN else {},
        adapters={task: expert.factors for task, expert in experts.by_task.items()} if selects else {},
        heads={task: _head(split.kept, recipe) for task, split in splits.items()},
        subspaces={task: _subspaces(expert, recipe) for task, expert in experts.by_task.items()},
        expert_digests={task: expert.card.digest for task, expert in experts.by_task.items()},
        action_steps={task: steps for task, expert in experts.by_task.items() if (steps := expert.card.action_steps)},
    )


def _splits(experts: Experts, recipe: Recipe) -> dict[str, TrunkSplit]:
    output = None if recipe.merge_output else OUTPUT
    return {
        task: split_trunk(expert.weights, recipe.kept_blocks, block_pattern=BLOCKS, output_pattern=output)
        for task, expert in experts.by_task.items()
    }


def _head(kept: Weights, recipe: Recipe) -> Weights:
    """What a task keeps for itself; under signs in bf16, as all that is stored there."""
    return {name: weight.bfloat16() for name, weight in kept.items()} if recipe.masks is MaskRule.SIGNS else kept


def _found_base(folder: Path, base: str) -> Path | str:
    """The base as a folder if it is one, else as its hub id, by which it can be found from elsewhere too."""
    return base_folder(folder, base) if (folder / base).is_dir() else base


def _check_frozen(task: str, tensors: Weights, base: Weights) -> None:
    for name, tensor in tensors.items():
        if name.startswith(BACKBONE) and not torch.equal(tensor, base[name]):
            raise ExpertsDiffer(f"expert {task}: expected a backbone tuned by adapters alone, got another {name}")


def _task_vectors(experts: Experts, splits: Mapping[str, TrunkSplit], recipe: Recipe) -> Taus:
    """What the operator and the masks are applied to: backbone and trunk, as far as the recipe says so.

    A weight that another expert has adapted and this one has not has a task vector of zeros.
    """
    taus: dict[str, dict[str, Tensor]] = {task: {} for task in experts.by_task}
    adapted = {name for expert in experts.by_task.values() for name in expert.factors}
    for task, expert in experts.by_task.items():
        if recipe.backbone is BackboneRule.MERGED:
            taus[task] |= {
                name: factors.delta() if (factors := expert.factors.get(name)) else torch.zeros(weight.shape)
                for name, weight in experts.base_weights.items()
                if name in adapted
            }
        if recipe.trunk is TrunkRule.VECTORS:
            shared = splits[task].shared
            taus[task] |= task_vector(shared, {name: experts.base_weights[name] for name in shared})
    return taus


def _merged(taus: Taus, recipe: Recipe) -> MergedTau:
    if not any(taus.values()):
        return MergedTau(tuple(taus), recipe.operator, recipe.alpha, MaskRule.NONE, {})
    return merge(
        taus,
        recipe.operator,
        alpha=recipe.alpha,
        rule=recipe.masks,
        lambdas=recipe.lambda_,
        options=recipe.options,
        rounds=recipe.rounds,
    )


def _instructions(tasks: Sequence[str], given: Mapping[str, str] | None) -> dict[str, str]:
    known = {task: card.instruction for task, card in task_cards().items()} | dict(given or {})
    for task in tasks:
        if task not in known:
            raise MergeError(f"expected an instruction for {task}: no simulator here has the task, and none was given")
    return {task: known[task] for task in tasks}


def _subspaces(expert: Expert, recipe: Recipe) -> tuple[Tensor, Tensor]:
    """Of block L - k - 1 from 0, the last that is merged; of the first if all blocks are kept."""
    block = max(expert.card.architecture.language.layers - recipe.kept_blocks - 1, 0)
    adapter, task = (leading(expert.weights[VALUES.format(block=block, path=path)]) for path in ("v_adapter", "v_task"))
    return adapter, task


def _stored(factors: Mapping[str, Factors]) -> dict[str, Tensor]:
    """Adapters as weights, for counting bytes."""
    return {f"{name}.{part}": getattr(f, part) for name, f in factors.items() for part in ("a", "b")}


def _short(card: Card) -> str:
    return (card.base_hash or "")[:16]
