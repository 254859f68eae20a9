"""Choice of lambda by held-out demonstrations, never by evaluation episodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from robogauntlet_mergevla.checkpoints.merge_experts import Experts, merge_parts
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel, MergedWeights
from robogauntlet_mergevla.merging.recipe import BackboneRule, MaskRule, Recipe, TrunkRule
from robogauntlet_mergevla.network.model import MergeVLA
from robogauntlet_mergevla.network.normalisation import TaskStatistics
from robogauntlet_mergevla.network.tokenizer import tokenizer_for
from robogauntlet_mergevla.training.batch_loss import BatchLoss
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture, HeldOut
from robogauntlet_mergevla.training.training_checkpoint import TrainingError

LAMBDAS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
"""Candidates for each task."""
BATCH = 64
NEEDED = {
    HeldOut.ALL: "to score",
    HeldOut.CHOICE: "to choose on",
    HeldOut.SCORE: "to score, beside those that lambda is chosen on",
}
Progress = Callable[[str], None]
"""Called with the value that is evaluated next."""


@torch.no_grad()
def held_out_l1(
    model_of: Callable[[str], MergeVLA],
    statistics: TaskStatistics,
    mixture: DatasetMixture,
    tasks: Sequence[str] | None = None,
    *,
    part: HeldOut = HeldOut.ALL,
) -> dict[str, float]:
    """Compute the mean L1 over the held-out episodes of each task, by default of all tasks in the mixture.

    `model_of` returns the network that acts in a task; `part` says which of the held-out episodes. Raises TrainingError
    if a task has none.
    """
    losses: dict[str, float] = {}
    for task in tasks or mixture.tasks:
        model = model_of(task)
        batch_loss = BatchLoss(
            model.architecture, statistics, tokenizer_for(model.architecture), next(model.parameters()).device
        )
        batches = list(mixture.held_out(BATCH, chunk_length=model.architecture.chunk_length, task=task, part=part))
        if not batches:
            raise TrainingError(
                f"expected held-out episodes of {task} {NEEDED[part]}, got too few: ten episodes give one"
            )
        weights = [int(batch.mask.sum()) for batch in batches]
        losses[task] = float(np.average([float(batch_loss.loss(model, batch)) for batch in batches], weights=weights))
    return losses


def experts_l1(
    experts: Experts,
    mixture: DatasetMixture,
    instructions: Mapping[str, str] | None = None,
    *,
    part: HeldOut = HeldOut.ALL,
) -> dict[str, float]:
    """Compute the mean L1 of the unmerged experts on their held-out episodes: the lower bound for merging."""
    recipe = Recipe(backbone=BackboneRule.SELECT, trunk=TrunkRule.MEAN)
    losses: dict[str, float] = {}
    for name, expert in experts.by_name.items():
        parts = merge_parts(replace(experts, by_name={name: expert}), recipe, instructions)
        losses |= merged_l1(parts, mixture, part=part)
    return losses


def merged_l1(parts: MergedWeights, mixture: DatasetMixture, *, part: HeldOut = HeldOut.ALL) -> dict[str, float]:
    """Compute the mean L1 of a merged model, oracle-routed, on the held-out episodes of each task."""
    model, expert_of = MergedModel(parts), parts.expert_of
    return held_out_l1(
        lambda task: model.model(expert_of[task]), parts.task_statistics, mixture, list(expert_of), part=part
    )


def choose_lambdas(
    experts: Experts,
    recipe: Recipe,
    mixture: DatasetMixture,
    instructions: Mapping[str, str] | None = None,
    *,
    among: Sequence[float] = LAMBDAS,
    progress: Progress | None = None,
) -> tuple[Recipe, dict[str, dict[float, float]]]:
    """Choose for each expert the lambda, out of `among`, of the smallest loss on half of its held-out demonstrations.

    That half is `HeldOut.CHOICE`; score the result on `HeldOut.SCORE`. An expert's weights depend on the merged task
    vector and its own mask alone, so each is treated separately; its loss is the mean over its tasks.

    Returns:
        The recipe with a lambda per expert, and expert to lambda to held-out L1.

    Raises:
        TrainingError: The recipe has no task masks, hence no lambda.
    """
    if recipe.masks is not MaskRule.TASK:
        raise TrainingError(f"expected task masks, whose lambda can be chosen, got masks '{recipe.masks}'")
    table: dict[str, dict[float, float]] = {name: {} for name in experts.by_name}
    for value in among:
        if progress is not None:
            progress(f"lambda {value:g}")
        parts = merge_parts(experts, replace(recipe, lambda_=value), instructions)
        losses = merged_l1(parts, mixture, part=HeldOut.CHOICE)
        for name, tasks in experts.tasks.items():
            table[name][value] = float(np.mean([losses[task] for task in tasks]))
    best = {name: min(losses, key=lambda value: (losses[value], value)) for name, losses in table.items()}
    return replace(recipe, lambda_=best), table
