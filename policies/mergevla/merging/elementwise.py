"""Operators that look at one entry of all experts at a time: mean, TA, TIES, DARE, EMR.

Each takes the experts' task vectors and gives tau_merge in fp32, before any alpha. Sums are taken in float64 and do
not depend on the order of the experts.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from policies.mergevla.merging.errors import check_range
from policies.mergevla.merging.taus import Tau, Taus, check_taus, names_of, order_free_sum, stack


def mean(taus: Taus) -> dict[str, torch.Tensor]:
    """The uniform mean of all deltas (model soups, arXiv 2203.05482).

    Raises:
        ExpertsDiffer: The task vectors do not fit each other.
    """
    check_taus(taus)
    return {name: (order_free_sum(stack(taus, name)) / len(taus)).float() for name in names_of(taus)}


def task_arithmetic(taus: Taus) -> dict[str, torch.Tensor]:
    """The plain sum of all deltas (arXiv 2212.04089, as MergeVLA's code has it: no division by their number).

    Raises:
        ExpertsDiffer: The task vectors do not fit each other.
    """
    check_taus(taus)
    return {name: order_free_sum(stack(taus, name)).float() for name in names_of(taus)}


def ties(taus: Taus, *, trim: float = 0.0) -> dict[str, torch.Tensor]:
    """Trim, elect a sign for each entry, sum the deltas that agree with it (arXiv 2306.01708).

    As MergeVLA's code: nothing is trimmed unless asked for, and the agreeing deltas are summed, not averaged. The
    elected sign is that of the sum. Where the sum is exactly zero it is the sign that most other entries of the whole
    task vector elected (positive if they are equally many).

    Args:
        taus: The experts' task vectors.
        trim: Share of each expert's entries, the smallest by magnitude over all weights, set to zero first, in [0, 1).

    Raises:
        ExpertsDiffer: The task vectors do not fit each other.
        OutOfRange: `trim` is outside [0, 1).
    """
    check_range("trim", trim, 0, 1, closed="[)")
    check_taus(taus)
    trimmed = {expert: _trimmed(tau, trim) for expert, tau in taus.items()} if trim else taus
    merged = elect_and_sum({name: stack(trimmed, name) for name in names_of(taus)})
    return {name: delta.float() for name, delta in merged.items()}


def elect_and_sum(stacks: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """TIES without trimming on deltas that are stacked already.

    Args:
        stacks: Name to deltas of all experts, shape (experts, *shape).

    Returns:
        Name to the sum of those that agree with the elected sign, float64, of `shape`.
    """
    signs = {name: order_free_sum(deltas).sign() for name, deltas in stacks.items()}
    majority = 1.0 if sum(sign.sum().item() for sign in signs.values()) >= 0 else -1.0
    merged = {}
    for name, deltas in stacks.items():
        elected = torch.where(signs[name] == 0, majority, signs[name])
        merged[name] = order_free_sum(torch.where(deltas * elected > 0, deltas, 0.0))
    return merged


def dare(taus: Taus, *, drop: float = 0.9, seed: int = 0) -> dict[str, torch.Tensor]:
    """Drop a random share of each expert's deltas, rescale the others by 1 / (1 - drop), sum (arXiv 2311.03099).

    What is dropped depends on the seed, the expert's and the weight's name alone, so neither another expert nor the
    machine changes it. In expectation this is `task_arithmetic`.

    Args:
        taus: The experts' task vectors.
        drop: Probability with which an entry is dropped, in [0, 1).
        seed: Of the draws, at least 0.

    Raises:
        ExpertsDiffer: The task vectors do not fit each other.
        OutOfRange: `drop` is outside [0, 1), or `seed` is no such number.
    """
    check_range("drop", drop, 0, 1, closed="[)")
    check_range("seed", seed, 0, float("inf"), closed="[)", whole=True)
    check_taus(taus)
    sparse = {
        expert: {name: _dropped(delta, drop, f"{seed}\0{expert}\0{name}") for name, delta in tau.items()}
        for expert, tau in taus.items()
    }
    return {name: order_free_sum(stack(sparse, name)).float() for name in names_of(taus)}


def emr(taus: Taus) -> dict[str, torch.Tensor]:
    """Elect the sign of the sum and take the greatest magnitude among the deltas that agree (arXiv 2405.17461).

    Where the sum is exactly zero the result is zero (sgn 0 = 0). What each task keeps of it: `emr_modulators`.

    Raises:
        ExpertsDiffer: The task vectors do not fit each other.
    """
    check_taus(taus)
    merged = {}
    for name in names_of(taus):
        deltas = stack(taus, name)
        sign = order_free_sum(deltas).sign().float()
        merged[name] = torch.where(deltas * sign > 0, deltas.abs(), 0.0).amax(dim=0) * sign
    return merged


@dataclass(frozen=True, eq=False)
class EmrModulator:
    """How one task reads EMR's unified task vector: rescaler * mask * tau_merge."""

    mask: Mapping[str, torch.Tensor]
    """True where the task's own delta has the unified sign."""
    rescaler: float


def emr_modulators(taus: Taus, merged: Tau) -> dict[str, EmrModulator]:
    """EMR's masks and rescalers (arXiv 2405.17461, the rescaler as MergeVLA's code computes it).

    The mask of task m is 1[tau_m * tau_merge > 0]; its rescaler is the mean of |tau_m| over that of
    |mask * tau_merge|, each summed over the weights; 1 if nothing is kept.

    Args:
        taus: The experts' task vectors.
        merged: What `emr` made of them, times any positive alpha (which the rescalers undo).
    """
    modulators = {}
    for expert, tau in taus.items():
        mask = {name: tau[name] * merged[name].sign() > 0 for name in merged}
        own = sum(_mean_magnitude(tau[name]) for name in merged)
        unified = sum(_mean_magnitude(merged[name] * mask[name]) for name in merged)
        modulators[expert] = EmrModulator(mask, own / unified if unified else 1.0)
    return modulators


def _mean_magnitude(delta: torch.Tensor) -> float:
    return delta.abs().to(torch.float64).mean().item() if delta.numel() else 0.0


def _trimmed(tau: Tau, trim: float) -> Tau:
    if not tau:
        return tau
    magnitudes = torch.cat([delta.abs().reshape(-1) for delta in tau.values()])
    dropped = int(trim * len(magnitudes))
    if not dropped:
        return tau
    threshold = magnitudes.kthvalue(dropped + 1).values
    return {name: torch.where(delta.abs() >= threshold, delta, 0.0) for name, delta in tau.items()}


def _dropped(delta: torch.Tensor, drop: float, key: str) -> torch.Tensor:
    seed = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "big", signed=True)
    # Drawn on the CPU, because another device's generator would draw other numbers.
    kept = torch.rand(delta.shape, generator=torch.Generator().manual_seed(seed)) >= drop
    return torch.where(kept.to(delta.device), delta / (1.0 - drop), 0.0)
