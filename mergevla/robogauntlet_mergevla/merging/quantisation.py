"""Weights with a few bits per entry and a scale per row (output).

Experts that are not merged, each with its own weights, quantised, are the bar that merging has to clear. Merged vectors
and what tasks keep beside them can be quantised in the same way, so that sizes compare like with like.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.masks import packed_bytes
from robogauntlet_mergevla.merging.task_vectors import as_rows

CLIPPING = torch.linspace(0.4, 1.0, 25)
"""Candidates for the largest magnitude that is represented, relative to the row's largest."""
CODES, SCALES = "codes/", "scales/"


@dataclass(frozen=True, eq=False)
class Quantised:
    """A matrix with a few bits per entry."""

    codes: torch.Tensor
    """Whole numbers of -(2^(bits - 1) - 1) .. 2^(bits - 1) - 1, int8, shape (rows, columns); 0 .. 2^bits - 1, uint8,
    where no sign is stored."""
    scales: torch.Tensor
    """What a code of 1 stands for in each row, bf16, shape (rows,)."""

    def dequantised(self) -> torch.Tensor:
        """Return the matrix, fp32."""
        return self.codes.float() * self.scales.float()[:, None]


def quantise(weight: torch.Tensor, bits: int, *, signed: bool = True) -> Quantised:
    """Round a weight to `bits` bits per entry, with the scale of each row that has the least squared error.

    A vector or number is one row; of more axes, the first is that of the rows. Without `signed` no entry is negative,
    and all bits are its magnitude's.
    """
    rows = as_rows(weight.detach().float())
    most = 2 ** (bits - signed) - 1
    largest = rows.abs().amax(dim=1) if rows.shape[1] else rows.new_zeros(len(rows))
    best, scales = torch.full_like(largest, torch.inf), torch.zeros_like(largest)
    for share in CLIPPING:
        tried = (largest * share / most).bfloat16().float()
        error = (_rounded(rows, tried, most) * tried[:, None] - rows).square().sum(dim=1)
        scales, best = torch.where(error < best, tried, scales), torch.minimum(error, best)
    codes = _rounded(rows, scales, most).to(torch.int8 if signed else torch.uint8)
    return Quantised(codes, scales.bfloat16())


def pack(matrices: Mapping[str, Quantised], bits: int) -> dict[str, torch.Tensor]:
    """Return matrices as tensors that safetensors can store: `codes/<name>`, packed bits, and `scales/<name>`."""
    packed = {}
    for name, matrix in matrices.items():
        shift = 0 if matrix.codes.dtype == torch.uint8 else 2 ** (bits - 1)
        unsigned = matrix.codes.cpu().numpy().astype(np.int16).reshape(-1, 1) + shift
        entries = np.unpackbits(unsigned.astype(np.uint8), axis=1)[:, -bits:]
        packed[CODES + name] = torch.from_numpy(np.packbits(entries))
        packed[SCALES + name] = matrix.scales
    return packed


def unpack(packed: Mapping[str, torch.Tensor], name: str, columns: int, bits: int, *, signed: bool = True) -> Quantised:
    """Return one of the matrices that `pack` packed.

    Args:
        packed: The result of `pack`.
        name: Name of the matrix.
        columns: Number of its columns. Its rows are as many as there are scales.
        bits: Bits per entry.
        signed: As it was quantised.

    Raises:
        ExpertsDiffer: A part is missing or of another type or size.
    """
    codes, scales = packed.get(CODES + name), packed.get(SCALES + name)
    if codes is None or scales is None:
        raise ExpertsDiffer(f"expected codes and scales of {name}, got no {'codes' if codes is None else 'scales'}")
    entries = len(scales) * columns if scales.ndim == 1 else -1
    if scales.dtype != torch.bfloat16 or codes.dtype != torch.uint8 or codes.shape != (packed_bytes(entries * bits),):
        raise ExpertsDiffer(
            f"expected {bits} bits for each entry of {name}, got {codes.dtype} {tuple(codes.shape)} "
            f"with scales {scales.dtype} {tuple(scales.shape)}"
        )
    flat = np.unpackbits(codes.cpu().numpy(), count=entries * bits).reshape(entries, bits)
    unsigned = flat @ (1 << np.arange(bits - 1, -1, -1, dtype=np.int16))
    entries_read = (unsigned - 2 ** (bits - 1)).astype(np.int8) if signed else unsigned.astype(np.uint8)
    return Quantised(torch.from_numpy(entries_read).reshape(len(scales), columns), scales)


def _rounded(rows: torch.Tensor, scales: torch.Tensor, most: int) -> torch.Tensor:
    return torch.where(scales[:, None] > 0, rows / scales[:, None], 0.0).round().clamp(-most, most)
