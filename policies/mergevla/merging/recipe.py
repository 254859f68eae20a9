"""How experts are to be merged. Light: no torch, so that a checkpoint's card can be read without it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from policies.mergevla.merging.errors import MergeError, OutOfRange, check_range

LAMBDA = 0.6
"""The paper's lambda in all benchmarks."""
MAX_LAMBDA = 2.0


class MaskRule(StrEnum):
    """What each task keeps of the merged task vector."""

    NONE = "none"
    """Everything: one model for all tasks."""
    TASK = "task"
    """S_m, see `masks.task_mask` (arXiv 2511.18810)."""
    EMR = "emr"
    """Agreement in sign and one rescaler, see `elementwise.emr_modulators` (arXiv 2405.17461)."""
    SIGNS = "signs"
    """All magnitudes, with signs and row scales of its own, see `signs`."""


MASKS_OF: Mapping[str, MaskRule] = MappingProxyType(
    {"emr": MaskRule.EMR, "magnitude": MaskRule.SIGNS, "flat": MaskRule.SIGNS}
)
"""Operator to the masks that were made for it; task masks go with all others."""


class TrunkRule(StrEnum):
    """How what comes before the kept blocks is shared: action queries, proprioception and action expert."""

    MEAN = "mean"
    """Uniform mean, for trunks of any initialisation (arXiv 2511.18810)."""
    VECTORS = "vectors"
    """Task vectors from the shared initialisation, by the operator and the masks of the backbone."""


class BackboneRule(StrEnum):
    """What each task's backbone is."""

    MERGED = "merged"
    """The base plus what the task reads of the merged task vector."""
    SELECT = "select"
    """The base plus the expert's own adapter: the baseline that merges no backbone at all."""


@dataclass(frozen=True)
class Recipe:
    """One way of merging."""

    operator: str = "ties"
    """Name out of `operators.OPERATORS`."""
    alpha: float = 1.0
    """Scale of the merged task vector."""
    masks: MaskRule = MaskRule.TASK
    lambda_: float | Mapping[str, float] = LAMBDA
    """Of the task masks: one for all, or expert name to its own."""
    trunk: TrunkRule = TrunkRule.VECTORS
    kept_blocks: int = 1
    """k, the last blocks of the action expert, which each task keeps with the output layer."""
    merge_output: bool = False
    """Merge the output layer with the trunk. With k = 0 and no masks, this is naive merging of everything."""
    backbone: BackboneRule = BackboneRule.MERGED
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of the operator."""
    rounds: int = 1
    """Bits that a task spends on each entry under `MaskRule.SIGNS`: each round reads what those before left over."""

    def __post_init__(self) -> None:
        for name, rule in (("masks", MaskRule), ("trunk", TrunkRule), ("backbone", BackboneRule)):
            value = getattr(self, name)
            if value not in tuple(rule):
                raise OutOfRange(f"expected {name} out of {', '.join(rule)}, got {value}")
            object.__setattr__(self, name, rule(value))
        if not isinstance(self.operator, str):
            raise OutOfRange(f"expected operator to be a name, got {self.operator!r}")
        if not isinstance(self.merge_output, bool):
            raise OutOfRange(f"expected merge_output to be true or false, got {self.merge_output!r}")
        if not isinstance(self.options, Mapping) or not all(isinstance(name, str) for name in self.options):
            raise OutOfRange(f"expected options to be names and values, got {self.options!r}")
        check_range("alpha", self.alpha, 0, math.inf)
        check_range("k, the blocks kept per task,", self.kept_blocks, 0, math.inf, closed="[)", whole=True)
        check_range("rounds", self.rounds, 1, math.inf, closed="[)", whole=True)
        if self.rounds > 1 and self.masks is not MaskRule.SIGNS:
            raise OutOfRange(f"expected masks '{MaskRule.SIGNS}' for {self.rounds} rounds, got '{self.masks}'")
        for value in self.lambda_.values() if isinstance(self.lambda_, Mapping) else (self.lambda_,):
            check_lambda(value)

    def as_json(self) -> dict[str, Any]:
        """As plain JSON; `Recipe.from_json` is the inverse."""
        lambdas = dict(self.lambda_) if isinstance(self.lambda_, Mapping) else self.lambda_
        return {**asdict(self), "lambda_": lambdas, "options": dict(self.options)}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Recipe:
        """The recipe that `as_json` wrote.

        Raises:
            MergeError: It is something else, or a value is out of range.
        """
        try:
            return cls(**plain)
        except TypeError as error:
            raise MergeError(f"expected a recipe for merging, got one that does not read: {error}") from None


def check_lambda(value: float) -> None:
    """Refuse a lambda outside (0, 2].

    Raises:
        OutOfRange: It is outside, or not a number.
    """
    check_range("lambda", value, 0, MAX_LAMBDA, closed="(]")
