"""Experts that a merged model keeps as they are, quantised: from experts, and from a checkpoint's tensors."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.quantisation import CODES, Quantised, quantise, unpack
from robogauntlet_mergevla.merging.task_vectors import Weights, as_rows
from robogauntlet_mergevla.network.lora import Factors

A, B = "/a", "/b"
Copy = Mapping[str, Quantised]
"""What fine-tuning added: `<weight>/a` and `<weight>/b`, the factors of a weight's adapter (scale included in b), and
`<weight>`, the difference to the base of any other weight."""


def quantised_copy(factors: Mapping[str, Factors], weights: Weights, base: Weights, bits: int) -> dict[str, Quantised]:
    """Return the copy of an expert with these adapters and these other trained weights."""
    added = {name: weight.float() - base[name].float() for name, weight in weights.items()}
    for name, adapter in factors.items():
        added |= {name + A: adapter.a, name + B: adapter.b * adapter.scale}
    return {name: quantise(tensor, bits) for name, tensor in added.items()}


def restored(copy: Copy, base: Weights) -> tuple[dict[str, Factors], dict[str, Tensor]]:
    """Return the adapters and the other weights of a copied expert."""
    factors, weights = {}, {}
    for name, matrix in copy.items():
        if name.endswith(A):
            weight = name.removesuffix(A)
            b = copy[weight + B].dequantised()
            factors[weight] = Factors(matrix.dequantised(), b, 1.0, base[weight].shape)
        elif not name.endswith(B):
            weights[name] = base[name].float() + matrix.dequantised().reshape(base[name].shape)
    return factors, weights


def unpacked_copy(tensors: Weights, base: Weights, bits: int, *, signed: bool = True) -> dict[str, Quantised]:
    """Return the copy that `quantisation.pack` packed. Raises ExpertsDiffer if it does not fit the base."""
    names = sorted(name.removeprefix(CODES) for name in tensors if name.startswith(CODES))
    copy: dict[str, Quantised] = {}
    for name in names:  # sorted, so that factors `a` come before `b`
        weight = name.removesuffix(A).removesuffix(B)
        if weight not in base or (name.endswith(B) and weight + A not in copy):
            raise ExpertsDiffer(f"expected weights of the base, or both factors of one, got {name}")
        rows = as_rows(torch.empty_like(base[weight], device="meta"))
        columns = len(copy[weight + A].scales) if name.endswith(B) else rows.shape[1]
        copy[name] = unpack(tensors, name, columns, bits, signed=signed)
        if not name.endswith(A) and len(copy[name].scales) != len(rows):
            raise ExpertsDiffer(f"expected {len(rows)} rows of {name}, got {len(copy[name].scales)}")
        if name.endswith(A) and weight + B not in names:
            raise ExpertsDiffer(f"expected both factors of {weight}, got one")
    return copy
