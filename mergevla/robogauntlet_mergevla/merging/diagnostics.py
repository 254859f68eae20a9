"""Diagnostics of a merge: rates of its masks compared with chance, distances between experts, and storage."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations

import torch

from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.masks import Mask, packed_bytes
from robogauntlet_mergevla.merging.merge import MergedTaskVectors, merge
from robogauntlet_mergevla.merging.recipe import MaskRule, Recipe
from robogauntlet_mergevla.merging.task_vectors import TaskVector, TaskVectors, Weights, rms
from robogauntlet_mergevla.merging.trunk import block_of, depth_of

NULL_ENTRIES = 30_000_000
"""Entries of each expert that the permutation null is computed from; of more weights than these, some are drawn."""
NULL_SHAPE = (640, 640)
"""Shape of the Gaussian matrix with which the null is simulated: its rates are then good to about 0.002."""
_FLOAT_BYTES = 4


@dataclass(frozen=True)
class MaskStatistics:
    """Rates of a set of masks, over all entries of all weights."""

    keep: Mapping[str, float]
    """Expert name to the share of entries that its mask keeps."""
    selfish: float
    """Share of entries kept by exactly one mask (arXiv 2511.18810 figure 3)."""
    cosine: Mapping[str, float]
    """Expert name to the cosine between its delta after merging and its own task vector; 0 if either is zero."""


@dataclass(frozen=True)
class BytesPerTask:
    """Storage of one task (bytes) in addition to the shared weights."""

    mask: int
    """Its mask, bit-packed, and row scales if it has any."""
    head: int
    """Its own blocks and output projection."""
    lora: int | None
    """For comparison: a LoRA adapter, in fp32, for each masked matrix; None if no rank was given."""


@dataclass(frozen=True)
class MergeReport:
    """Diagnostics of a merge that need no run of the model."""

    experts: tuple[str, ...]
    entries: int
    """Number of entries of the merged weights."""
    observed: MaskStatistics
    null: MaskStatistics
    """The same for the experts' entries in a random order within each weight: the result of chance."""
    gaussian: MaskStatistics
    """The same for independent Gaussian task vectors with the experts' root mean squares."""
    scales: Mapping[str, float]
    """Expert name to the root mean square of its task vector."""
    bytes_per_task: Mapping[str, BytesPerTask] = field(default_factory=dict)
    block_distances: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Part of the model, such as `action_expert`, to the distance between experts in each of its blocks."""

    def to_json(self) -> str:
        """Return the report as JSON with sorted keys."""
        return json.dumps(asdict(self), sort_keys=True, indent=2, allow_nan=False)


def keep_rate(mask: Mask) -> float:
    """Share of entries that a mask keeps; 0 without entries."""
    entries = sum(kept.numel() for kept in mask.values())
    return sum(int(kept.sum()) for kept in mask.values()) / entries if entries else 0.0


def selfish_rate(masks: Sequence[Mask]) -> float:
    """Share of entries kept by exactly one mask, mean_i 1[sum_m S_m,i = 1] (arXiv 2511.18810); 0 without entries."""
    entries = selfish = 0
    for name in masks[0]:
        keepers = torch.stack([mask[name] for mask in masks]).sum(dim=0)
        entries += keepers.numel()
        selfish += int((keepers == 1).sum())
    return selfish / entries if entries else 0.0


def cosine(a: TaskVector, b: TaskVector) -> float:
    """Cosine of the angle between two task vectors over all weights, in float64; 0 if either is zero."""
    product, norms = 0.0, [0.0, 0.0]
    for name in a:
        x, y = a[name].to(torch.float64), b[name].to(torch.float64)
        product += (x * y).sum().item()
        norms[0] += x.square().sum().item()
        norms[1] += y.square().sum().item()
    length = math.sqrt(norms[0]) * math.sqrt(norms[1])
    return max(-1.0, min(1.0, product / length)) if length else 0.0


def mask_statistics(task_vectors: TaskVectors, merged: MergedTaskVectors) -> MaskStatistics:
    """Compute keep rates, selfish rate and cosines. Without masks, and with signs, every task keeps everything.

    Raises ExpertsDiffer if the task vectors are not of the merged experts.
    """
    if task_vectors.keys() != set(merged.experts):
        raise ExpertsDiffer(f"expected the merged experts {', '.join(merged.experts)}, got {', '.join(task_vectors)}")
    cosines = {expert: cosine(merged.of(expert), vector) for expert, vector in task_vectors.items()}
    if not merged.masks or merged.recipe.masks is MaskRule.SIGNS:
        return MaskStatistics(dict.fromkeys(task_vectors, 1.0), 1.0 if len(task_vectors) == 1 else 0.0, cosines)
    keep = {expert: keep_rate(merged.masks[expert]) for expert in task_vectors}
    return MaskStatistics(keep, selfish_rate([merged.masks[expert] for expert in task_vectors]), cosines)


def permutation_null(task_vectors: TaskVectors, recipe: Recipe, *, generator: torch.Generator) -> MaskStatistics:
    """Compute the statistics of the same entries in a random order within each weight: the null hypothesis.

    Every weight of every expert keeps its scale and its heavy tails, and only the relation between experts is broken: a
    difference from this is a relation between tasks.

    Args:
        task_vectors: The experts' task vectors.
        recipe: Recipe of the merge.
        generator: Source of the orders, on the CPU.
    """
    names = _drawn(next(iter(task_vectors.values())), generator)
    shuffled = {
        expert: {name: _shuffled(vector[name], generator) for name in names} for expert, vector in task_vectors.items()
    }
    return mask_statistics(shuffled, merge(shuffled, recipe))


def _drawn(vector: TaskVector, generator: torch.Generator) -> list[str]:
    """Names of weights with `NULL_ENTRIES` together, at least one; all names if there are no more entries."""
    sizes = {name: delta.numel() for name, delta in vector.items()}
    names = list(sizes)
    if sum(sizes.values()) <= NULL_ENTRIES:
        return names
    drawn: list[str] = []
    for place in torch.randperm(len(names), generator=generator).tolist():
        if not drawn or sum(sizes[name] for name in drawn) + sizes[names[place]] <= NULL_ENTRIES:
            drawn.append(names[place])
    return drawn


def _shuffled(delta: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    return delta.reshape(-1)[torch.randperm(delta.numel(), generator=generator)].reshape(delta.shape)


def gaussian_null(
    scales: Mapping[str, float], recipe: Recipe, *, generator: torch.Generator, shape: tuple[int, ...] = NULL_SHAPE
) -> MaskStatistics:
    """Compute the statistics of independent Gaussian task vectors under the same merge.

    Masks from TIES of four unrelated updates are 73 % selfish. Compare with `permutation_null`, which also has the
    unequal scales of weights and the tails of their entries.

    Args:
        scales: Expert name to the standard deviation of its entries.
        recipe: Recipe of the merge.
        generator: Source of the draws, on the CPU.
        shape: Shape of the one weight that is simulated.
    """
    drawn = {expert: {"w": torch.randn(shape, generator=generator) * scale} for expert, scale in scales.items()}
    return mask_statistics(drawn, merge(drawn, recipe))


def block_distances(experts: Mapping[str, Weights]) -> tuple[float, ...]:
    """Compute the distance between experts (name to weights) in each block: the mean of 2 ||a - b|| / (||a|| + ||b||).

    The mean is over all pairs; zeros for a single expert. 0 for equal blocks, sqrt 2 for unrelated ones of equal norm,
    at most 2. Weights in no block are left out. Compare with the distance of the untrained experts: with independent
    initialisations that is nearly all of it.
    """
    first = next(iter(experts.values()))
    names: list[list[str]] = [[] for _ in range(depth_of(first))]
    for name in first:
        if (index := block_of(name)) is not None:
            names[index].append(name)
    pairs = list(combinations(experts.values(), 2))
    return tuple(
        math.fsum(_relative_distance(a, b, block) for a, b in pairs) / len(pairs) if pairs else 0.0 for block in names
    )


def _relative_distance(a: Weights, b: Weights, names: Sequence[str]) -> float:
    def norm(tensors: Sequence[torch.Tensor]) -> float:
        return math.sqrt(math.fsum(t.to(torch.float64).square().sum().item() for t in tensors))

    size = norm([a[name] for name in names]) + norm([b[name] for name in names])
    apart = norm([a[name].to(torch.float64) - b[name].to(torch.float64) for name in names])
    return 2 * apart / size if size else 0.0


def bytes_per_task(
    vector: TaskVector, head: Weights, *, masks: int = 1, row_scales: int = 0, lora_rank: int | None = None
) -> BytesPerTask:
    """Compute a task's storage in addition to the shared weights.

    Args:
        vector: Any task vector of the masked weights, for their shapes.
        head: The task's own weights, as they are stored.
        masks: Number of masks of the task.
        row_scales: Size of the task's row scales (bytes).
        lora_rank: Rank of the adapters for comparison, each of rank * (outputs + inputs) numbers.
    """
    mask = masks * sum(packed_bytes(delta.numel()) for delta in vector.values()) + row_scales
    matrices = [delta.shape for delta in vector.values() if delta.ndim == 2]
    lora = None if lora_rank is None else _FLOAT_BYTES * lora_rank * sum(sum(shape) for shape in matrices)
    return BytesPerTask(mask, _bytes(head), lora)


def _row_scale_bytes(merged: MergedTaskVectors, expert: str) -> int:
    """Size of an expert's row scales in all rounds."""
    more = _row_scale_bytes(merged.residual, expert) if merged.residual else 0
    return _bytes(merged.row_scales.get(expert, {})) + more


def _bytes(weights: Weights) -> int:
    return sum(weight.numel() * weight.element_size() for weight in weights.values())


def report(
    task_vectors: TaskVectors,
    merged: MergedTaskVectors,
    *,
    generator: torch.Generator,
    heads: Mapping[str, Weights] | None = None,
    lora_rank: int | None = None,
    weights: Mapping[str, Weights] | None = None,
) -> MergeReport:
    """Compute all of the above for one merge.

    Args:
        task_vectors: The experts' task vectors; ExpertsDiffer if they are not of the merged experts.
        merged: Result of `merge.merge`.
        generator: Source of the draws of both nulls, on the CPU.
        heads: Expert name to the weights that it keeps.
        lora_rank: See `bytes_per_task`.
        weights: Expert name to its weights, for `block_distances`.
    """
    observed = mask_statistics(task_vectors, merged)
    scales = {expert: rms(vector) for expert, vector in task_vectors.items()}
    has_entries = any(task_vectors.values())
    heads = heads or {}
    return MergeReport(
        experts=merged.experts,
        entries=sum(delta.numel() for delta in merged.vector.values()),
        observed=observed,
        null=permutation_null(task_vectors, merged.recipe, generator=generator) if has_entries else observed,
        gaussian=gaussian_null(scales, merged.recipe, generator=generator) if has_entries else observed,
        scales=scales,
        bytes_per_task={
            expert: bytes_per_task(
                vector,
                heads.get(expert, {}),
                masks=merged.recipe.rounds if merged.masks else 0,
                row_scales=_row_scale_bytes(merged, expert),
                lora_rank=lora_rank,
            )
            for expert, vector in task_vectors.items()
        },
        block_distances={"action_expert": block_distances(weights)} if weights else {},
    )
