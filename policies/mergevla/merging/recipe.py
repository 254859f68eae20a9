"""How experts are to be merged. Light: no torch, so that a checkpoint's metadata can be read without it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, ClassVar

from pydantic import StrictBool, StrictFloat, StrictInt
from pydantic.dataclasses import dataclass

from robogauntlet.policies.mergevla.merging.errors import OutOfRange, check_range
from robogauntlet.policies.stored import STRICT, Stored

LAMBDA = 0.6
"""The paper's lambda in all benchmarks."""
MAX_LAMBDA = 2.0
Number = StrictInt | StrictFloat
"""Kept as it is given, since recipes are hashed: 1 stays 1."""


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


@dataclass(frozen=True, config=STRICT)
class Recipe(Stored):
    """One way of merging."""

    what: ClassVar = "recipe for merging"
    refusal: ClassVar = OutOfRange

    operator: str = "ties"
    """Name out of `operators.OPERATORS`."""
    alpha: Number = 1.0
    """Scale of the merged task vector."""
    masks: MaskRule = MaskRule.TASK
    lambda_: Number | Mapping[str, Number] = LAMBDA
    """Of the task masks: one for all, or expert name to its own."""
    trunk: TrunkRule = TrunkRule.VECTORS
    kept_blocks: StrictInt = 1
    """k, the last blocks of the action expert, which each task keeps with the output layer."""
    merge_output: StrictBool = False
    """Merge the output layer with the trunk. With k = 0 and no masks, this is naive merging of everything."""
    backbone: BackboneRule = BackboneRule.MERGED
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of the operator."""
    rounds: StrictInt = 1
    """Bits that a task spends on each entry under `MaskRule.SIGNS`: each round reads what those before left over."""

    def __post_init__(self) -> None:
        check_range("alpha", self.alpha, 0, math.inf)
        check_range("k, the blocks kept per task,", self.kept_blocks, 0, math.inf, closed="[)", whole=True)
        check_range("rounds", self.rounds, 1, math.inf, closed="[)", whole=True)
        if self.rounds > 1 and self.masks is not MaskRule.SIGNS:
            raise OutOfRange(f"expected masks '{MaskRule.SIGNS}' for {self.rounds} rounds, got '{self.masks}'")
        for value in self.lambda_.values() if isinstance(self.lambda_, Mapping) else (self.lambda_,):
            check_lambda(value)


def check_lambda(value: float) -> None:
    """Refuse a lambda outside (0, 2].

    Raises:
        OutOfRange: It is outside, or not a number.
    """
    check_range("lambda", value, 0, MAX_LAMBDA, closed="(]")
