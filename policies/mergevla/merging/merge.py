"""Merging task vectors and masking the result in one call."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch

from robogauntlet.policies.mergevla.merging.elementwise import emr_modulators
from robogauntlet.policies.mergevla.merging.errors import ExpertsDiffer
from robogauntlet.policies.mergevla.merging.masks import Mask, lambdas_of, masked, task_masks
from robogauntlet.policies.mergevla.merging.operators import merge_task_vectors
from robogauntlet.policies.mergevla.merging.recipe import MaskRule, Recipe
from robogauntlet.policies.mergevla.merging.signs import read_signs, sign_readings
from robogauntlet.policies.mergevla.merging.task_vectors import TaskVector, TaskVectors


@dataclass(frozen=True, eq=False)
class MergedTaskVectors:
    """One task vector for all experts, with the masks and scales by which each task reads it."""

    experts: tuple[str, ...]
    recipe: Recipe
    """The recipe of the merge; with `MaskRule.NONE` if there was nothing to merge."""
    vector: TaskVector
    """tau_merge, alpha included; under `MaskRule.SIGNS` rounded to bf16."""
    masks: Mapping[str, Mask] = field(default_factory=dict)
    """Expert name to its mask, under `MaskRule.SIGNS` True where it is positive; empty under `MaskRule.NONE`."""
    rescalers: Mapping[str, float] = field(default_factory=dict)
    """Expert name to rescaler; empty unless under `MaskRule.EMR`."""
    row_scales: Mapping[str, TaskVector] = field(default_factory=dict)
    """Expert name to weight name to a scale for each row; empty unless under `MaskRule.SIGNS`."""
    residual: MergedTaskVectors | None = None
    """The experts' residuals, merged in the same way; None after the last round."""

    def of(self, expert: str) -> dict[str, torch.Tensor]:
        """Return the expert's delta to the base: rescaler * S_m * tau_merge, or r_m * s_m * |tau_merge| of all rounds.

        Raises:
            ExpertsDiffer: The expert was not merged.
        """
        if expert not in self.experts:
            raise ExpertsDiffer(f"expected one of the merged experts {', '.join(self.experts)}, got {expert}")
        if self.recipe.masks is MaskRule.SIGNS:
            read = read_signs(self.vector, self.masks[expert], self.row_scales[expert])
            more = self.residual.of(expert) if self.residual else {}
            return {name: delta + more[name] if name in more else delta for name, delta in read.items()}
        kept = masked(self.vector, self.masks[expert]) if self.masks else dict(self.vector)
        rescaler = self.rescalers.get(expert, 1.0)
        return {name: delta * rescaler for name, delta in kept.items()} if rescaler != 1.0 else kept


def merge(task_vectors: TaskVectors, recipe: Recipe) -> MergedTaskVectors:
    """Merge task vectors and mask the result for each task.

    Args:
        task_vectors: The experts' task vectors.
        recipe: Operator with options, alpha, masks with lambda, and rounds.

    Raises:
        MergeError: Unknown operator or option, values out of range, or experts that do not fit each other.
    """
    rule = recipe.masks
    lambdas = lambdas_of(task_vectors, recipe.lambda_) if rule is MaskRule.TASK else {}
    vector: TaskVector = merge_task_vectors(recipe.operator, task_vectors, alpha=recipe.alpha, options=recipe.options)
    masks: Mapping[str, Mask] = {}
    rescalers: Mapping[str, float] = {}
    row_scales: Mapping[str, TaskVector] = {}
    if rule is MaskRule.TASK:
        masks = task_masks(task_vectors, vector, lambdas)
    elif rule is MaskRule.EMR:
        modulators = emr_modulators(task_vectors, vector)
        masks = {expert: modulator.mask for expert, modulator in modulators.items()}
        rescalers = {expert: modulator.rescaler for expert, modulator in modulators.items()}
    elif rule is MaskRule.SIGNS:
        # bf16 halves the storage: one bit per entry has a far larger error than this rounding.
        vector = {name: delta.bfloat16().float() for name, delta in vector.items()}
        readings = sign_readings(task_vectors, vector)
        masks = {expert: reading.signs for expert, reading in readings.items()}
        row_scales = {expert: reading.row_scales for expert, reading in readings.items()}
    merged = MergedTaskVectors(tuple(task_vectors), recipe, vector, masks, rescalers, row_scales)
    if recipe.rounds == 1:
        return merged
    residuals: dict[str, TaskVector] = {}
    for expert, deltas in task_vectors.items():
        read = merged.of(expert)
        residuals[expert] = {name: delta - read[name] for name, delta in deltas.items()}
    return replace(merged, residual=merge(residuals, replace(recipe, rounds=recipe.rounds - 1)))
