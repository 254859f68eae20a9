"""Operators that treat each entry on its own: mean, TA, TIES, DARE, EMR.

Each takes the experts' task vectors and returns tau_merge in fp32, before alpha. Sums are taken in float64 and do not
depend on the order of the experts. Options out of range raise OutOfRange.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import partial

import torch

from robogauntlet_mergevla.merging.errors import check_range
from robogauntlet_mergevla.merging.task_vectors import (
    OnDemand,
    TaskVector,
    TaskVectors,
    names_of,
    order_free_sum,
    stack,
)

BLOCK = 2**16
"""Entries of each expert that are elected at once."""
PUBLISHED_TRIM = 0.8
"""Share of an expert's entries that TIES as published sets to zero: the greatest 20 % are kept."""


def mean(task_vectors: TaskVectors) -> dict[str, torch.Tensor]:
    """The uniform mean of all deltas (model soups, arXiv 2203.05482)."""
    return {
        name: (order_free_sum(stack(task_vectors, name)) / len(task_vectors)).float() for name in names_of(task_vectors)
    }


def task_arithmetic(task_vectors: TaskVectors) -> dict[str, torch.Tensor]:
    """The plain sum of all deltas (arXiv 2212.04089, as MergeVLA's code has it: no division by their number)."""
    return {name: order_free_sum(stack(task_vectors, name)).float() for name in names_of(task_vectors)}


def ties(task_vectors: TaskVectors, *, trim: float = 0.0) -> dict[str, torch.Tensor]:
    """Elect a sign for each entry and sum the deltas that agree with it, as MergeVLA's code does.

    The elected sign is that of the sum. Where the sum is exactly zero, it is the sign that the majority of the whole
    task vector's entries elected (positive in a tie).

    `trim`, in [0, 1), is the share of each expert's entries, the smallest by magnitude over all weights, that is set to
    zero first.
    """
    return _ties(task_vectors, trim, average=False)


def ties_published(task_vectors: TaskVectors, *, trim: float = PUBLISHED_TRIM) -> dict[str, torch.Tensor]:
    """Trim each expert to its greatest fifth, elect signs, average the deltas that agree (arXiv 2306.01708).

    The average is over the experts whose entry is not zero and has the elected sign (disjoint mean). The paper then
    scales the result by a value that it searches for: see `Recipe.alpha`. `trim` as for `ties`.
    """
    return _ties(task_vectors, trim, average=True)


def _ties(task_vectors: TaskVectors, trim: float, *, average: bool) -> dict[str, torch.Tensor]:
    check_range("trim", trim, 0, 1, closed="[)")
    cut = {expert: trimmed(vector, trim) for expert, vector in task_vectors.items()} if trim else task_vectors
    stacks = OnDemand({name: partial(stack, cut, name) for name in names_of(task_vectors)})
    return elect(stacks, average=average, dtype=torch.float32)


def elect(
    stacks: Mapping[str, torch.Tensor], *, average: bool, dtype: torch.dtype = torch.float64
) -> dict[str, torch.Tensor]:
    """Elect the sign of each entry, and sum or average the deltas that agree with it and are not zero.

    `stacks` are the experts' deltas, shape (experts, *shape), by name; the result is of `shape`, computed in float64.
    """
    merged: dict[str, torch.Tensor] = {}
    balance, undecided = 0.0, []
    for name, deltas in stacks.items():
        elections = [_elected(block, 1.0, average=average) for block in _blocks(deltas)]
        merged[name] = torch.cat([sums for sums, _ in elections]).to(dtype).reshape(deltas.shape[1:])
        balance += sum(signs.sum().item() for _, signs in elections)
        if not all(signs.all() for _, signs in elections):
            undecided.append(name)
    for name in undecided if balance < 0 else ():
        blocks = _blocks(deltas := stacks[name])
        sums = [_elected(block, -1.0, average=average)[0] for block in blocks]
        merged[name] = torch.cat(sums).to(dtype).reshape(deltas.shape[1:])
    return merged


def _blocks(deltas: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Parts that fit into a processor's cache, (experts, n)."""
    return deltas.unsqueeze(1).flatten(1).split(BLOCK, dim=1)


def _elected(deltas: torch.Tensor, majority: float, *, average: bool) -> tuple[torch.Tensor, torch.Tensor]:
    """The sums or means of the deltas that agree, and the signs of all sums, where 0 counts as `majority`."""
    signs = order_free_sum(deltas).sign()
    agrees = deltas * torch.where(signs == 0, majority, signs).to(deltas.dtype) > 0
    merged = order_free_sum(torch.where(agrees, deltas, 0.0))
    return merged / agrees.sum(dim=0).clamp(min=1) if average else merged, signs


def dare(task_vectors: TaskVectors, *, drop: float = 0.9, seed: int = 0) -> dict[str, torch.Tensor]:
    """Drop a random share of each expert's deltas, rescale the others by 1 / (1 - drop), sum (arXiv 2311.03099).

    The dropped entries depend only on the seed and the names of expert and weight, not on other experts or the machine.
    The expectation is that of `task_arithmetic`.

    `drop`, in [0, 1), is the probability with which an entry is dropped; `seed` is that of the draws, at least 0.
    """
    check_range("drop", drop, 0, 1, closed="[)")
    check_range("seed", seed, 0, float("inf"), closed="[)", whole=True)
    sparse = {
        expert: {name: _dropped(delta, drop, f"{seed}\0{expert}\0{name}") for name, delta in vector.items()}
        for expert, vector in task_vectors.items()
    }
    return {name: order_free_sum(stack(sparse, name)).float() for name in names_of(task_vectors)}


def emr(task_vectors: TaskVectors) -> dict[str, torch.Tensor]:
    """Elect the sign of the sum and take the greatest magnitude among the deltas that agree (arXiv 2405.17461).

    Where the sum is exactly zero, the result is zero (sgn 0 = 0). `emr_modulators` computes masks and rescalers.
    """
    merged = {}
    for name in names_of(task_vectors):
        deltas = stack(task_vectors, name)
        sign = order_free_sum(deltas).sign().float()
        merged[name] = torch.where(deltas * sign > 0, deltas.abs(), 0.0).amax(dim=0) * sign
    return merged


def emr_modulators(
    task_vectors: TaskVectors, merged: TaskVector
) -> tuple[dict[str, dict[str, torch.Tensor]], dict[str, float]]:
    """EMR's mask and rescaler of each task (arXiv 2405.17461, the rescaler as MergeVLA's code computes it).

    The delta of task m is rescaler * mask * tau_merge. The mask is 1[tau_m * tau_merge > 0]; the rescaler is the mean
    of |tau_m| over that of |mask * tau_merge|, each summed over the weights; 1 if nothing is kept. `merged` is the
    result of `emr`, times any positive alpha (which the rescalers undo).
    """
    masks, rescalers = {}, {}
    for expert, vector in task_vectors.items():
        mask = {name: vector[name] * merged[name].sign() > 0 for name in merged}
        own = sum(_mean_magnitude(vector[name]) for name in merged)
        unified = sum(_mean_magnitude(merged[name] * mask[name]) for name in merged)
        masks[expert], rescalers[expert] = mask, own / unified if unified else 1.0
    return masks, rescalers


def _mean_magnitude(delta: torch.Tensor) -> float:
    return delta.abs().to(torch.float64).mean().item() if delta.numel() else 0.0


def trimmed(vector: TaskVector, trim: float) -> TaskVector:
    """Set the share `trim` of the entries to zero, the smallest by magnitude over all weights."""
    if not vector:
        return vector
    magnitudes = torch.cat([delta.abs().reshape(-1) for delta in vector.values()])
    dropped = int(trim * len(magnitudes))
    if not dropped:
        return vector
    threshold = magnitudes.kthvalue(dropped + 1).values
    return {name: torch.where(delta.abs() >= threshold, delta, 0.0) for name, delta in vector.items()}


def _dropped(delta: torch.Tensor, drop: float, key: str) -> torch.Tensor:
    seed = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "big", signed=True)
    # Drawn on the CPU, since other devices' generators draw other numbers.
    kept = torch.rand(delta.shape, generator=torch.Generator().manual_seed(seed)) >= drop
    return torch.where(kept.to(delta.device), delta / (1.0 - drop), 0.0)
