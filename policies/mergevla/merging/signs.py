"""Signs: each task keeps a sign for every entry and a scale for every row; magnitudes alone are shared.

A task mask spends a bit on each entry to say whether the merged value is kept; the other entries fall back to the
base. The same bit spent on the sign keeps every entry: tau_m is read as r_m * s_m * |tau_merge|, with s_m the signs of
tau_m and r_m one scale per row (output), the least-squares fit. This joins EMR's rescaled masks (arXiv 2405.17461)
with one-bit deltas (BitDelta, arXiv 2402.10193, which shares nothing: operator `flat`). Needs no lambda and no data.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from policies.mergevla.merging.errors import ExpertsDiffer
from policies.mergevla.merging.masks import Mask, check_mask
from policies.mergevla.merging.taus import Tau, Taus, check_taus, difference, names_of, order_free_sum, stack


@dataclass(frozen=True, eq=False)
class SignReading:
    """How one task reads shared magnitudes."""

    signs: Mask
    """True where the task's own delta is not negative."""
    row_scales: Tau
    """Weight name to one scale per row, fp32, of shape (rows,); weights that are no matrices have one row."""


def magnitude(taus: Taus) -> dict[str, torch.Tensor]:
    """The magnitudes that serve all experts best when each scales its rows: of no sign, so for `MaskRule.SIGNS`.

    Of each row it is the leading right singular vector of the experts' magnitudes, shape (experts, columns), which
    minimises sum_m ||tau_m - r_m * s_m * magnitude||^2 over all r_m and magnitudes at once (Eckart and Young), and is
    nowhere negative (Perron and Frobenius). Its scale is the root mean square over the experts.

    Raises:
        ExpertsDiffer: The task vectors do not fit each other.
    """
    check_taus(taus)
    return {name: _leading(stack(taus, name)) for name in names_of(taus)}


def flat(taus: Taus) -> dict[str, torch.Tensor]:
    """One magnitude for all entries of a row, the mean: with signs, tasks share nothing (BitDelta, arXiv 2402.10193).

    The control for `magnitude`: what the bits do without any merged vector.

    Raises:
        ExpertsDiffer: The task vectors do not fit each other.
    """
    check_taus(taus)
    return {name: _flat(stack(taus, name)) for name in names_of(taus)}


def sign_readings(taus: Taus, merged: Tau) -> dict[str, SignReading]:
    """Signs and row scales of each task.

    Args:
        taus: The experts' task vectors.
        merged: tau_merge; its magnitudes are what is read.

    Raises:
        ExpertsDiffer: A task vector does not fit the merged one.
    """
    for tau in taus.values():
        if problem := difference(merged, tau):
            raise ExpertsDiffer(f"the task vector does not fit the merged one: {problem}")
    return {
        expert: SignReading(
            {name: delta >= 0 for name, delta in tau.items()},
            {name: _row_scales(delta, merged[name]) for name, delta in tau.items()},
        )
        for expert, tau in taus.items()
    }


def check_row_scales(row_scales: Tau, merged: Tau) -> None:
    """Refuse row scales for another model.

    Raises:
        ExpertsDiffer: Names differ, or there is not one scale for each row.
    """
    expected = {name: delta.new_empty(len(_rows(delta))) for name, delta in merged.items()}
    if problem := difference(expected, row_scales):
        raise ExpertsDiffer(f"the row scales are for another model: {problem}")


def read_signs(merged: Tau, signs: Mask, row_scales: Tau) -> dict[str, torch.Tensor]:
    """r_m * s_m * |tau_merge|.

    Raises:
        MaskMismatch: The signs are for another model.
        ExpertsDiffer: The row scales are.
    """
    check_mask(signs, merged)
    check_row_scales(row_scales, merged)
    read = {}
    for name, delta in merged.items():
        signed = torch.where(signs[name], delta.abs(), -delta.abs())
        read[name] = (_rows(signed) * row_scales[name][:, None]).reshape(delta.shape)
    return read


def _rows(delta: torch.Tensor) -> torch.Tensor:
    """A weight as a matrix: its first axis by all others; a vector or number as one row."""
    return delta.flatten(1) if delta.ndim > 1 else delta.reshape(1, -1)


def _row_scales(delta: torch.Tensor, merged: torch.Tensor) -> torch.Tensor:
    own, shared = (_rows(tensor).abs().to(torch.float64) for tensor in (delta, merged))
    squares = shared.square().sum(dim=1)
    return torch.where(squares > 0, (own * shared).sum(dim=1) / squares, 0.0).float()


def _leading(deltas: torch.Tensor) -> torch.Tensor:
    if not deltas.numel():
        return torch.zeros_like(deltas[0])
    by_row = torch.stack([_rows(delta) for delta in deltas], dim=1).abs().to(torch.float64)
    _, values, vectors = torch.linalg.svd(by_row, full_matrices=False)
    scale = values[:, :1] / len(deltas) ** 0.5
    return (scale * vectors[:, 0].abs()).float().reshape(deltas.shape[1:])


def _flat(deltas: torch.Tensor) -> torch.Tensor:
    if not deltas.numel():
        return torch.zeros_like(deltas[0])
    by_row = _rows(order_free_sum(deltas.abs())) / len(deltas)
    return by_row.mean(dim=1, keepdim=True).expand_as(by_row).float().reshape(deltas.shape[1:]).clone()
