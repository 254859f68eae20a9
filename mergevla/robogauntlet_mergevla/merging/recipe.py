"""The recipe of a merge. Light: no torch, so that a checkpoint's metadata can be read without it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, ClassVar

from pydantic import SerializerFunctionWrapHandler, StrictBool, StrictFloat, StrictInt, model_serializer
from pydantic.dataclasses import dataclass

from robogauntlet.policies.stored import STRICT, Stored
from robogauntlet_mergevla.merging.errors import OutOfRange, check_range
from robogauntlet_mergevla.merging.parts import check_parts

LAMBDA = 0.6
"""The paper's lambda in all benchmarks."""
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
    """All magnitudes, with the task's own signs and row scales, see `signs`."""


UNMERGED = "none"
"""The operator that merges nothing: each task keeps its expert, quantised, see `quantisation`."""
MASKS_OF: Mapping[str, MaskRule] = MappingProxyType(
    {"emr": MaskRule.EMR, "magnitude": MaskRule.SIGNS, "flat": MaskRule.SIGNS, UNMERGED: MaskRule.NONE}
)
"""Operator to the masks that were designed for it; all others use task masks."""


class TrunkRule(StrEnum):
    """How the trunk is shared: action queries, proprioception and the action expert before the kept blocks."""

    MEAN = "mean"
    """Uniform mean, for trunks of any initialisation (arXiv 2511.18810)."""
    VECTORS = "vectors"
    """Task vectors from the shared initialisation, by the operator and the masks of the backbone."""


class BackboneRule(StrEnum):
    """The backbone of each task."""

    MERGED = "merged"
    """The base plus the task's delta from the merged task vector."""
    SELECT = "select"
    """The base plus the expert's own adapter: the baseline without merging of the backbone."""


@dataclass(frozen=True, config=STRICT)
class Recipe(Stored):
    """Every option of a merge."""

    what: ClassVar = "recipe for merging"
    refusal: ClassVar = OutOfRange

    operator: str = "ties"
    """One of `merge.operator_names`, or `UNMERGED`."""
    alpha: Number = 1.0
    """Scale of the merged task vector."""
    masks: MaskRule = MaskRule.TASK
    lambda_: Number | Mapping[str, Number] = LAMBDA
    """Lambda of the task masks: one for all, or expert name to its own."""
    trunk: TrunkRule = TrunkRule.VECTORS
    kept_blocks: StrictInt = 1
    """k, the last blocks of the action expert, which each task keeps with the output layer."""
    merge_output: StrictBool = False
    """Merge the output layer with the trunk. With k = 0 and no masks, this is naive merging of everything."""
    backbone: BackboneRule = BackboneRule.MERGED
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the operator."""
    rounds: StrictInt = 1
    """Bits per entry of a task under `MaskRule.SIGNS`: each round approximates the residual of those before."""
    only: tuple[str, ...] = ()
    """Parts that are merged, see `parts`; each task keeps its own of all others. Empty for all parts."""
    bits: StrictInt | None = None
    """Bits per entry of all weights that are stored beside the base, merged or kept, see `quantisation`; None for the
    weights' own types. Where nothing is merged, the operator's option says it."""

    def __post_init__(self) -> None:
        check_range("alpha", self.alpha, 0, math.inf)
        check_range("k, the blocks kept per task,", self.kept_blocks, 0, math.inf, closed="[)", whole=True)
        check_range("rounds", self.rounds, 1, math.inf, closed="[)", whole=True)
        if self.bits is not None:
            check_range("bits", self.bits, 2, 8, closed="[]", whole=True)
        if self.rounds > 1 and self.masks is not MaskRule.SIGNS:
            raise OutOfRange(f"expected masks '{MaskRule.SIGNS}' for {self.rounds} rounds, got '{self.masks}'")
        if self.operator == UNMERGED:
            check_range("bits", self.options.get("bits"), 2, 8, closed="[]", whole=True)
            if self.bits is not None:
                raise OutOfRange(f"expected bits as an option of the operator '{UNMERGED}', got both")
            if self.masks is not MaskRule.NONE:
                raise OutOfRange(f"expected masks '{MaskRule.NONE}' where nothing is merged, got '{self.masks}'")
        check_parts(self.only)
        for value in self.lambda_.values() if isinstance(self.lambda_, Mapping) else (self.lambda_,):
            check_lambda(value)

    @property
    def stored_bits(self) -> int | None:
        """Bits per entry of what each task keeps; None for the weights' own types."""
        return self.options["bits"] if self.operator == UNMERGED else self.bits

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave `only` and `bits` out if they are not used, as in recipes from before them."""
        plain: dict[str, Any] = write(self)
        return {name: value for name, value in plain.items() if value or name not in ("only", "bits")}


def check_lambda(value: float) -> None:
    """Raise OutOfRange unless lambda is a number in (0, 2]."""
    check_range("lambda", value, 0, 2, closed="(]")
