"""Signs: each task keeps a sign for every entry and a scale for every row; only magnitudes are shared.

A task mask spends one bit per entry on whether the merged value is kept; the other entries fall back to the base. The
same bit spent on the sign keeps every entry: tau_m is approximated by r_m * s_m * |tau_merge|, with s_m the signs of
tau_m and r_m one scale per row (output), the least-squares fit. This combines EMR's rescaled masks (arXiv 2405.17461)
with one-bit deltas (BitDelta, arXiv 2402.10193, which shares nothing: operator `flat`). It needs neither lambda nor
data.
"""

from __future__ import annotations

import torch

from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.masks import Mask, check_mask
from robogauntlet_mergevla.merging.task_vectors import (
    TaskVector,
    TaskVectors,
    as_rows,
    difference,
    names_of,
    order_free_sum,
    stack,
)


def magnitude(task_vectors: TaskVectors) -> dict[str, torch.Tensor]:
    """Return the magnitudes that fit all experts best when each scales its rows; for `MaskRule.SIGNS`, as unsigned.

    Each row is the leading right singular vector of the experts' magnitudes, shape (experts, columns), which minimises
    sum_m ||tau_m - r_m * s_m * magnitude||^2 jointly over all r_m and magnitudes (Eckart and Young) and has no negative
    entry (Perron and Frobenius). Its scale is the root mean square over the experts.
    """
    return {name: _leading(stack(task_vectors, name)) for name in names_of(task_vectors)}


def flat(task_vectors: TaskVectors) -> dict[str, torch.Tensor]:
    """Return the mean magnitude of each row for all its entries (BitDelta, arXiv 2402.10193).

    The control for `magnitude`: the effect of the sign bits without a merged vector.
    """
    return {name: _flat(stack(task_vectors, name)) for name in names_of(task_vectors)}


def fit_signs(task_vectors: TaskVectors, merged: TaskVector) -> tuple[dict[str, Mask], dict[str, TaskVector]]:
    """Return the signs and the row scales of each task; of `merged`, tau_merge, only magnitudes are used.

    Signs are True where the task's own delta is not negative. Row scales are fp32, of shape (rows,); a weight that is
    no matrix is one row. Raises ExpertsDiffer if a task vector does not fit the merged one.
    """
    for vector in task_vectors.values():
        if problem := difference(merged, vector):
            raise ExpertsDiffer(f"the task vector does not fit the merged one: {problem}")
    signs: dict[str, Mask] = {}
    row_scales: dict[str, TaskVector] = {}
    for expert, vector in task_vectors.items():
        signs[expert] = {name: delta >= 0 for name, delta in vector.items()}
        row_scales[expert] = {name: _row_scales(delta, merged[name]) for name, delta in vector.items()}
    return signs, row_scales


def check_row_scales(row_scales: TaskVector, merged: TaskVector) -> None:
    """Raise ExpertsDiffer unless there is one scale for each row of each merged weight."""
    expected = {name: delta.new_empty(len(as_rows(delta))) for name, delta in merged.items()}
    if problem := difference(expected, row_scales):
        raise ExpertsDiffer(f"the row scales are for another model: {problem}")


def apply_signs(merged: TaskVector, signs: Mask, row_scales: TaskVector) -> dict[str, torch.Tensor]:
    """r_m * s_m * |tau_merge|. Raises MaskMismatch or ExpertsDiffer if signs or row scales are for another model."""
    check_mask(signs, merged)
    check_row_scales(row_scales, merged)
    deltas = {}
    for name, delta in merged.items():
        signed = torch.where(signs[name], delta.abs(), -delta.abs())
        deltas[name] = (as_rows(signed) * row_scales[name][:, None]).reshape(delta.shape)
    return deltas


def _row_scales(delta: torch.Tensor, merged: torch.Tensor) -> torch.Tensor:
    own, shared = (as_rows(tensor).abs().to(torch.float64) for tensor in (delta, merged))
    squares = shared.square().sum(dim=1)
    return torch.where(squares > 0, (own * shared).sum(dim=1) / squares, 0.0).float()


def _leading(deltas: torch.Tensor) -> torch.Tensor:
    if not deltas.numel():
        return torch.zeros_like(deltas[0])
    by_row = torch.stack([as_rows(delta) for delta in deltas], dim=1).abs().to(torch.float64)
    _, values, vectors = torch.linalg.svd(by_row, full_matrices=False)
    scale = values[:, :1] / len(deltas) ** 0.5
    return (scale * vectors[:, 0].abs()).float().reshape(deltas.shape[1:])


def _flat(deltas: torch.Tensor) -> torch.Tensor:
    if not deltas.numel():
        return torch.zeros_like(deltas[0])
    by_row = as_rows(order_free_sum(deltas.abs())) / len(deltas)
    return by_row.mean(dim=1, keepdim=True).expand_as(by_row).float().reshape(deltas.shape[1:]).clone()
