"""Operators that treat a weight matrix as a whole: TSV, KnOTS, WUDI.

Each takes the experts' task vectors and returns tau_merge in fp32, before alpha. Decompositions are in float64.
Options out of range raise OutOfRange.
"""

from __future__ import annotations

from typing import Literal

import torch

from robogauntlet.policies.mergevla.merging.elementwise import elect_and_sum
from robogauntlet.policies.mergevla.merging.errors import OutOfRange, check_range
from robogauntlet.policies.mergevla.merging.task_vectors import TaskVectors, names_of, order_free_sum, stack


def _is_matrix(deltas: torch.Tensor) -> bool:
    """Whether stacked deltas are those of a matrix with entries."""
    return deltas.ndim == 3 and deltas.numel() > 0


def _mean(deltas: torch.Tensor) -> torch.Tensor:
    return (order_free_sum(deltas) / len(deltas)).float()


def task_singular_vectors(task_vectors: TaskVectors) -> dict[str, torch.Tensor]:
    """Keep each expert's first singular triplets, orthogonalise them together, recompose (TSV-M, arXiv 2412.00081).

    Each of M experts keeps n // M, at least one, of the n = min(outputs, inputs) singular values of a matrix. The
    experts' concatenated left singular vectors are replaced by the nearest orthonormal ones (Procrustes: U V^T of
    their own decomposition), and so are the right ones. Triplets whose singular value is zero in fp32 precision are
    left out: LoRA's deltas have few others, and arbitrary null vectors would rotate those of the other experts.
    Weights that are not matrices are averaged.
    """
    stacks = {name: stack(task_vectors, name) for name in names_of(task_vectors)}
    return {name: _tsv(deltas) if _is_matrix(deltas) else _mean(deltas) for name, deltas in stacks.items()}


def _tsv(deltas: torch.Tensor) -> torch.Tensor:
    left, values, right = [], [], []
    for delta in deltas:
        u, s, vh = torch.linalg.svd(delta.to(torch.float64), full_matrices=False)
        zero = s[0] * max(delta.shape) * torch.finfo(torch.float32).eps
        kept = min(max(1, len(s) // len(deltas)), int((s > zero).sum()))
        left.append(u[:, :kept])
        values.append(s[:kept])
        right.append(vh[:kept])
    s = torch.cat(values)
    if not len(s):
        return torch.zeros_like(deltas[0])
    return (_orthonormal(torch.cat(left, dim=1)) * s @ _orthonormal(torch.cat(right, dim=0))).float()


def _orthonormal(matrix: torch.Tensor) -> torch.Tensor:
    """The nearest matrix with orthonormal columns or rows, whichever are fewer (orthogonal Procrustes)."""
    u, _, vh = torch.linalg.svd(matrix, full_matrices=False)
    return u @ vh


def knots(
    task_vectors: TaskVectors, *, aligned: Literal["ties", "sum"] = "ties", cutoff: float = 1e-4
) -> dict[str, torch.Tensor]:
    """Merge in the space shared by all experts (arXiv 2410.19735).

    Each matrix's deltas, side by side along the inputs, are decomposed: [tau_1 .. tau_M] = U S [V_1^T .. V_M^T]. The
    V_m^T are merged, and U S is multiplied back. As published (KnOTS-TIES) the V_m^T of all weights are merged by
    TIES. MergeVLA's code sums them, and U S sum_m V_m^T = sum_m tau_m is task arithmetic except for the cut-off.
    Weights that are not matrices are merged unchanged, together with the rest.

    `aligned` is how the aligned parts are merged: `ties` (published) or `sum` (MergeVLA's code). `cutoff`, at least 0,
    is the largest singular value (absolute) that is left out.
    """
    check_range("cutoff", cutoff, 0, float("inf"), closed="[)")
    if aligned not in ("ties", "sum"):
        raise OutOfRange(f"expected aligned to be ties or sum, got {aligned}")
    bases, parts = {}, {}
    for name in names_of(task_vectors):
        deltas = stack(task_vectors, name)
        if _is_matrix(deltas):
            bases[name], parts[name] = _aligned(deltas, cutoff)
        else:
            parts[name] = deltas
    merged = elect_and_sum(parts) if aligned == "ties" else {name: order_free_sum(p) for name, p in parts.items()}
    return {name: (bases[name] @ part if name in bases else part).float() for name, part in merged.items()}


def _aligned(deltas: torch.Tensor, cutoff: float) -> tuple[torch.Tensor, torch.Tensor]:
    """U S of shape (outputs, r), and V_m^T of all experts, shape (experts, r, inputs)."""
    experts, outputs, inputs = deltas.shape
    joint = deltas.to(torch.float64).transpose(0, 1).reshape(outputs, experts * inputs)
    u, s, vh = torch.linalg.svd(joint, full_matrices=False)
    kept = s > cutoff
    return u[:, kept] * s[kept], vh[kept].reshape(-1, experts, inputs).transpose(0, 1)


def wudi(task_vectors: TaskVectors, *, steps: int = 300, learning_rate: float = 1e-5) -> dict[str, torch.Tensor]:
    """Minimise the interference of the merged delta with each expert's (arXiv 2503.08099).

    For each matrix, starting at the sum, Adam minimises sum_m ||(tau - tau_m) tau_m^T||_F^2 / ||tau_m||_F^2. Its
    gradient is 2 sum_m (tau - tau_m) G_m with G_m = tau_m^T tau_m / ||tau_m||_F^2. Experts that did not change the
    matrix are left out. Weights that are not matrices are averaged. `steps`, at least 0, and `learning_rate`, greater
    than 0, are Adam's.
    """
    check_range("steps", steps, 0, float("inf"), closed="[)", whole=True)
    check_range("learning_rate", learning_rate, 0, float("inf"))
    stacks = {name: stack(task_vectors, name) for name in names_of(task_vectors)}
    return {
        name: _wudi(deltas, steps, learning_rate) if _is_matrix(deltas) else _mean(deltas)
        for name, deltas in stacks.items()
    }


def _wudi(deltas: torch.Tensor, steps: int, learning_rate: float) -> torch.Tensor:
    start = order_free_sum(deltas).float()
    changed = [delta for delta in deltas if delta.any()]
    if not changed:
        return start
    units = [(delta.double() / delta.double().norm()).float() for delta in changed]
    grams = [unit.T @ unit for unit in units]
    # The gradient is affine in the displacement from the start. In this form it is exactly zero for a single expert;
    # in any other, Adam would follow rounding errors, since it ignores their size.
    at_start = sum(
        ((start - delta) @ gram for delta, gram in zip(changed, grams, strict=True)), torch.zeros_like(start)
    )
    gram = sum(grams, torch.zeros_like(grams[0]))
    moved = torch.nn.Parameter(torch.zeros_like(start))
    adam = torch.optim.Adam([moved], lr=learning_rate)
    for _ in range(steps):
        moved.grad = 2 * (at_start + moved.detach() @ gram)
        adam.step()
    return start + moved.detach()
