"""Merging task vectors by an operator, and masking the result for each task."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import metadata
from types import MappingProxyType
from typing import Any

import torch

from robogauntlet.suites.plugins import did_you_mean
from robogauntlet_mergevla.merging.elementwise import (
    dare,
    emr,
    emr_modulators,
    mean,
    task_arithmetic,
    ties,
    ties_published,
)
from robogauntlet_mergevla.merging.errors import ExpertsDiffer, MergeError, check_range
from robogauntlet_mergevla.merging.masks import Mask, lambdas_of, masked, task_masks
from robogauntlet_mergevla.merging.quantisation import Quantised, quantise
from robogauntlet_mergevla.merging.recipe import UNMERGED, MaskRule, Recipe
from robogauntlet_mergevla.merging.signs import apply_signs, fit_signs, flat, magnitude
from robogauntlet_mergevla.merging.task_vectors import OnDemand, TaskVector, TaskVectors, check_task_vectors

Operator = Callable[..., dict[str, torch.Tensor]]
"""Takes the experts' task vectors, checked by `check_task_vectors`, and its options as keyword-only arguments. Returns
tau_merge in fp32."""
OPERATORS: Mapping[str, Operator] = MappingProxyType(
    {
        "mean": mean,
        "ta": task_arithmetic,
        "ties": ties,
        "ties-published": ties_published,
        "dare": dare,
        "emr": emr,
        "magnitude": magnitude,
        "flat": flat,
    }
)
"""The operators of this package that merge, by name. The functions' docstrings name the papers."""
PLUGINS = "robogauntlet_mergevla.operators"
"""Group of entry points by which other distributions add operators."""


class UnknownOperator(MergeError):
    """Unknown merge operator, or unknown option of one."""


def operator_names() -> tuple[str, ...]:
    """Names of all operators that merge, those of other distributions last."""
    return (*OPERATORS, *sorted(metadata.entry_points(group=PLUGINS).names - OPERATORS.keys()))


def operator_of(name: str) -> Operator:
    """Return the operator of a name. Raises UnknownOperator if there is none."""
    if name in OPERATORS:
        return OPERATORS[name]
    for entry in metadata.entry_points(group=PLUGINS, name=name):
        operator: Operator = entry.load()
        return operator
    raise UnknownOperator(f"unknown merge operator '{name}'{did_you_mean(name, (*operator_names(), UNMERGED))}")


def check_operator(name: str, options: Iterable[str] = ()) -> None:
    """Raise UnknownOperator if the operator, or an option of it, is unknown."""
    known = ["bits"] if name == UNMERGED else inspect.getfullargspec(operator_of(name)).kwonlyargs
    for option in options:
        if option not in known:
            raise UnknownOperator(f"operator '{name}' has no option '{option}'; it has: {', '.join(known) or 'none'}")


def merge_task_vectors(
    operator: str, task_vectors: TaskVectors, *, alpha: float = 1.0, options: Mapping[str, Any] | None = None
) -> dict[str, torch.Tensor]:
    """tau_merge = alpha * R({tau_m}) (arXiv 2511.18810 equation 2).

    Args:
        operator: Name of R.
        task_vectors: The experts' task vectors.
        alpha: Scale of the merged task vector, greater than 0; the paper's is 1.
        options: Options of the operator.

    Raises:
        UnknownOperator: Unknown operator or option.
        OutOfRange: alpha or an option is out of range.
        ExpertsDiffer: The task vectors do not fit each other.
    """
    check_operator(operator, options or {})
    check_range("alpha", alpha, 0, float("inf"))
    check_task_vectors(task_vectors)
    merged = operator_of(operator)(task_vectors, **(options or {}))
    return {name: delta * alpha for name, delta in merged.items()} if alpha != 1 else merged


@dataclass(frozen=True, eq=False)
class MergedTaskVectors:
    """One task vector for all experts, with the masks and scales that turn it into each expert's own delta."""

    experts: tuple[str, ...]
    recipe: Recipe
    """The recipe of the merge; with `MaskRule.NONE` if there was nothing to merge."""
    vector: TaskVector
    """tau_merge, alpha included; in the base's types, under `MaskRule.SIGNS` rounded to bf16, or as `codes` say."""
    masks: Mapping[str, Mask] = field(default_factory=dict)
    """Expert name to its mask, under `MaskRule.SIGNS` True where it is positive; empty under `MaskRule.NONE`."""
    rescalers: Mapping[str, float] = field(default_factory=dict)
    """Expert name to rescaler; empty unless under `MaskRule.EMR`."""
    row_scales: Mapping[str, TaskVector] = field(default_factory=dict)
    """Expert name to weight name to a scale for each row; empty unless under `MaskRule.SIGNS`."""
    residual: MergedTaskVectors | None = None
    """The experts' residuals, merged in the same way; None after the last round."""
    codes: Mapping[str, Quantised] = field(default_factory=dict)
    """The quantised form of `vector` under `Recipe.bits`, else empty."""

    def of(self, expert: str) -> TaskVector:
        """Return the expert's delta to the base: rescaler * S_m * tau_merge, or r_m * s_m * |tau_merge| of all rounds.

        A weight's delta is computed when it is asked for. Raises ExpertsDiffer if the expert was not merged.
        """
        if expert not in self.experts:
            raise ExpertsDiffer(f"expected one of the merged experts {', '.join(self.experts)}, got {expert}")
        more = self.residual.of(expert) if self.residual else {}
        return OnDemand({name: partial(self._delta, expert, name, more) for name in self.vector})

    def _delta(self, expert: str, name: str, more: TaskVector) -> torch.Tensor:
        """One weight's delta; `more` are the residuals."""
        vector = {name: self.vector[name]}
        mask = {name: self.masks[expert][name]} if self.masks else {}
        if self.recipe.masks is MaskRule.SIGNS:
            delta = apply_signs(vector, mask, {name: self.row_scales[expert][name]})[name]
            return delta + more[name] if name in more else delta
        kept = (masked(vector, mask) if mask else vector)[name]
        return kept.float() * self.rescalers[expert] if expert in self.rescalers else kept


def merge(
    task_vectors: TaskVectors, recipe: Recipe, types: Mapping[str, torch.dtype] | None = None
) -> MergedTaskVectors:
    """Merge task vectors and mask the result for each task, as the recipe says.

    `types` are those of the base's weights, to which the result is rounded before it is masked; by default fp32. Raises
    MergeError for an unknown operator or option, values out of range, or experts that do not fit each other.
    """
    rule = recipe.masks
    lambdas = lambdas_of(task_vectors, recipe.lambda_) if rule is MaskRule.TASK else {}
    vector = merge_task_vectors(recipe.operator, task_vectors, alpha=recipe.alpha, options=recipe.options)
    codes: dict[str, Quantised] = {}
    if recipe.bits is not None:
        for name, delta in vector.items():
            is_signed = rule is not MaskRule.SIGNS
            codes[name] = quantise(delta if is_signed else delta.abs(), recipe.bits, signed=is_signed)
            vector[name] = codes[name].dequantised().reshape(delta.shape)
    elif types is not None and rule is not MaskRule.SIGNS:
        for name in vector:  # one by one, since both together may not fit into memory
            vector[name] = vector[name].to(types[name])
    masks: Mapping[str, Mask] = {}
    rescalers: Mapping[str, float] = {}
    row_scales: Mapping[str, TaskVector] = {}
    if rule is MaskRule.TASK:
        masks = task_masks(task_vectors, vector, lambdas)
    elif rule is MaskRule.EMR:
        masks, rescalers = emr_modulators(task_vectors, vector)
    elif rule is MaskRule.SIGNS:
        if not codes:  # bf16 halves the storage: one bit per entry has a far larger error than this rounding
            vector = {name: delta.bfloat16().float() for name, delta in vector.items()}
        masks, row_scales = fit_signs(task_vectors, vector)
    merged = MergedTaskVectors(tuple(task_vectors), recipe, vector, masks, rescalers, row_scales, codes=codes)
    if recipe.rounds == 1:
        return merged
    residuals: dict[str, TaskVector] = {}
    for expert, deltas in task_vectors.items():
        stored = merged.of(expert)
        residuals[expert] = {name: delta - stored[name] for name, delta in deltas.items()}
    return replace(merged, residual=merge(residuals, replace(recipe, rounds=recipe.rounds - 1)))
