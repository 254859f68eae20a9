"""Operators that treat a weight matrix as a whole: TSV, KnOTS, WUDI.

Each takes the experts' task vectors and returns tau_merge in fp32, before alpha. Decompositions are in float64. A
weight of more than two axes, such as a convolution's, is a matrix of its outputs by all others. Weights that are no
matrices, such as biases, are summed as by task arithmetic. Options out of range raise OutOfRange.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch

from robogauntlet_mergevla.merging.errors import check_range
from robogauntlet_mergevla.merging.task_vectors import TaskVectors, names_of, order_free_sum, stack

EXACT = 1e-12
"""Cut-off of the least interference: singular values below it are rounding errors of float64."""


def _merged_by(task_vectors: TaskVectors, operator: Callable[[torch.Tensor], torch.Tensor]) -> dict[str, torch.Tensor]:
    """Merge matrices by an operator on (experts, outputs, inputs), and sum all other weights."""
    merged = {}
    for name in names_of(task_vectors):
        deltas = stack(task_vectors, name)
        is_matrix = deltas.ndim > 2 and deltas.numel()
        result = operator(deltas.flatten(2)) if is_matrix else order_free_sum(deltas)
        merged[name] = result.float().reshape(deltas.shape[1:])
    return merged


def task_singular_vectors(task_vectors: TaskVectors) -> dict[str, torch.Tensor]:
    """Keep each expert's first singular triplets, orthogonalise them together, recompose (TSV-M, arXiv 2412.00081).

    Each of M experts keeps n // M, at least one, of the n = min(outputs, inputs) singular values of a matrix. The
    experts' concatenated left singular vectors are replaced by the nearest orthonormal ones (Procrustes: U V^T of
    their own decomposition), and so are the right ones. Triplets whose singular value is zero in fp32 precision are
    left out: LoRA's deltas have few others, and arbitrary null vectors would rotate those of the other experts.
    """
    return _merged_by(task_vectors, _tsv)


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


def knots(task_vectors: TaskVectors, *, cutoff: float = 1e-4) -> dict[str, torch.Tensor]:
    """Sum the experts in the space that they share, as MergeVLA's code does (after arXiv 2410.19735).

    Each matrix's deltas, side by side along the inputs, are decomposed: [tau_1 .. tau_M] = U S [V_1^T .. V_M^T]. The
    V_m^T are summed, and U S is multiplied back: U S sum_m V_m^T = sum_m tau_m, task arithmetic except for the
    cut-off.

    `cutoff`, at least 0, is the largest singular value (absolute) that is left out.
    """
    check_range("cutoff", cutoff, 0, float("inf"), closed="[)")
    return _merged_by(task_vectors, lambda deltas: _knots(deltas, cutoff))


def _knots(deltas: torch.Tensor, cutoff: float) -> torch.Tensor:
    experts, outputs, inputs = deltas.shape
    joint = deltas.to(torch.float64).transpose(0, 1).reshape(outputs, experts * inputs)
    u, s, vh = torch.linalg.svd(joint, full_matrices=False)
    kept = s > cutoff
    return u[:, kept] @ order_free_sum((s[kept, None] * vh[kept]).reshape(-1, experts, inputs).transpose(0, 1))


def wudi(task_vectors: TaskVectors, *, cutoff: float = 1e-2) -> dict[str, torch.Tensor]:
    """Minimise the interference of the merged delta with each expert's, in closed form (after arXiv 2503.08099).

    The interference of tau is sum_m ||(tau - tau_m) tau_m^T||_F^2 / ||tau_m||_F^2. Its gradient is
    2 sum_m (tau - tau_m) G_m with G_m = tau_m^T tau_m / ||tau_m||_F^2, so that the minimum which is nearest to the sum
    is tau = sum - (sum_m (sum - tau_m) G_m) (sum_m G_m)^+. Experts that did not change a matrix are left out.

    `cutoff`, in [0, 1), is the singular value of sum_m G_m, relative to the greatest, below which the sum is left as it
    is: there no expert writes much, and the minimum would be far from all of them.
    """
    check_range("cutoff", cutoff, 0, 1, closed="[)")
    return _merged_by(task_vectors, lambda deltas: _wudi(deltas, cutoff))


def _wudi(deltas: torch.Tensor, cutoff: float) -> torch.Tensor:
    start = order_free_sum(deltas)
    gradient, gram = _interference_gradient(start, deltas)
    return start - gradient @ torch.linalg.pinv(gram, rtol=max(cutoff, EXACT), hermitian=True)


def _interference_gradient(start: torch.Tensor, deltas: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Half the gradient at the start, and its change with the displacement, sum_m G_m."""
    gradient = torch.zeros_like(start)
    gram = start.new_zeros(start.shape[1], start.shape[1])
    for own, unit in _with_directions(deltas):
        of_one = unit.T @ unit
        gradient += (start - own) @ of_one
        gram += of_one
    return gradient, gram


def _with_directions(deltas: torch.Tensor) -> Sequence[tuple[torch.Tensor, torch.Tensor]]:
    """Each expert's delta, and the same of norm 1, in float64; without those that are zero."""
    wide = [delta.to(torch.float64) for delta in deltas if delta.any()]
    return [(delta, delta / delta.norm()) for delta in wide]
