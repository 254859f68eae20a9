"""Merging task vectors and masking the result in one call, and what that gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch

from policies.mergevla.merging.elementwise import emr_modulators
from policies.mergevla.merging.errors import ExpertsDiffer, OutOfRange
from policies.mergevla.merging.masks import Mask, add, lambdas_of, masked, task_masks
from policies.mergevla.merging.operators import merge_taus
from policies.mergevla.merging.recipe import LAMBDA, MaskRule
from policies.mergevla.merging.signs import read_signs, sign_readings
from policies.mergevla.merging.taus import Tau, Taus, Weights


@dataclass(frozen=True, eq=False)
class MergedTau:
    """One task vector for all experts, and how each task reads it."""

    experts: tuple[str, ...]
    operator: str
    alpha: float
    rule: MaskRule
    tau: Tau
    """tau_merge, alpha included; under `MaskRule.SIGNS` rounded to bf16."""
    masks: Mapping[str, Mask] = field(default_factory=dict)
    """Expert name to its mask, which under `MaskRule.SIGNS` says where it is positive; empty under `MaskRule.NONE`."""
    lambdas: Mapping[str, float] = field(default_factory=dict)
    """Expert name to lambda; empty unless under `MaskRule.TASK`."""
    rescalers: Mapping[str, float] = field(default_factory=dict)
    """Expert name to rescaler; empty unless under `MaskRule.EMR`."""
    row_scales: Mapping[str, Tau] = field(default_factory=dict)
    """Expert name to weight name to a scale for each row; empty unless under `MaskRule.SIGNS`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of the operator, as given."""
    residual: MergedTau | None = None
    """What the experts have beyond this, merged in the same way; None after the last round."""

    @property
    def rounds(self) -> int:
        """Rounds of merging, this one included."""
        return 1 + (self.residual.rounds if self.residual else 0)

    def of(self, expert: str) -> dict[str, torch.Tensor]:
        """What that task adds to the base: rescaler * S_m * tau_merge, or r_m * s_m * |tau_merge| over all rounds.

        Raises:
            ExpertsDiffer: It was not among the merged ones.
        """
        if expert not in self.experts:
            raise ExpertsDiffer(f"expected one of the merged experts {', '.join(self.experts)}, got {expert}")
        if self.rule is MaskRule.SIGNS:
            read = read_signs(self.tau, self.masks[expert], self.row_scales[expert])
            more = self.residual.of(expert) if self.residual else {}
            return {name: delta + more[name] if name in more else delta for name, delta in read.items()}
        kept = masked(self.tau, self.masks[expert]) if self.masks else dict(self.tau)
        rescaler = self.rescalers.get(expert, 1.0)
        return {name: delta * rescaler for name, delta in kept.items()} if rescaler != 1.0 else kept

    def weights(self, base: Weights, expert: str) -> dict[str, torch.Tensor]:
        """Theta^(m), the weights with which that task runs.

        Raises:
            ExpertsDiffer: It was not among the merged ones, or the base does not fit.
        """
        return add(base, self.of(expert))


def merge(
    taus: Taus,
    operator: str = "ta",
    *,
    alpha: float = 1.0,
    rule: MaskRule = MaskRule.TASK,
    lambdas: float | Mapping[str, float] = LAMBDA,
    options: Mapping[str, Any] | None = None,
    rounds: int = 1,
) -> MergedTau:
    """Merge task vectors and mask the result for each task.

    Args:
        taus: The experts' task vectors.
        operator: Name out of `operators.OPERATORS`.
        alpha: Scale of the merged task vector, greater than 0.
        rule: What each task keeps.
        lambdas: One for all or expert name to its own, in (0, 2]; used under `MaskRule.TASK` only.
        options: Of the operator.
        rounds: Under `MaskRule.SIGNS`, see `Recipe.rounds`.

    Raises:
        MergeError: Its subclasses, for an unknown operator or option, values out of range, or experts that differ.
    """
    if rule not in tuple(MaskRule):
        raise OutOfRange(f"expected a mask rule out of {', '.join(MaskRule)}, got {rule}")
    rule = MaskRule(rule)
    chosen = lambdas_of(taus, lambdas) if rule is MaskRule.TASK else {}
    tau = merge_taus(operator, taus, alpha=alpha, options=options)
    masks: Mapping[str, Mask] = {}
    rescalers: Mapping[str, float] = {}
    row_scales: Mapping[str, Tau] = {}
    if rule is MaskRule.TASK:
        masks = task_masks(taus, tau, chosen)
    elif rule is MaskRule.EMR:
        modulators = emr_modulators(taus, tau)
        masks = {expert: modulator.mask for expert, modulator in modulators.items()}
        rescalers = {expert: modulator.rescaler for expert, modulator in modulators.items()}
    elif rule is MaskRule.SIGNS:
        # Stored in half the bytes: a bit per entry errs by far more than this rounding.
        tau = {name: delta.bfloat16().float() for name, delta in tau.items()}
        readings = sign_readings(taus, tau)
        masks = {expert: reading.signs for expert, reading in readings.items()}
        row_scales = {expert: reading.row_scales for expert, reading in readings.items()}
    merged = MergedTau(
        tuple(taus), operator, alpha, rule, tau, masks, chosen, rescalers, row_scales, dict(options or {})
    )
    if rounds == 1:
        return merged
    left = {expert: _left(tau, merged.of(expert)) for expert, tau in taus.items()}
    return replace(merged, residual=merge(left, operator, alpha=alpha, rule=rule, options=options, rounds=rounds - 1))


def _left(tau: Tau, read: Tau) -> dict[str, torch.Tensor]:
    return {name: delta - read[name] for name, delta in tau.items()}
