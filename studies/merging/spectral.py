"""Operators that treat a weight matrix as a whole: TSV, KnOTS, WUDI.

Each takes the experts' task vectors and returns tau_merge in fp32, before alpha. Decompositions are in float64. A
weight of more than two axes, such as a convolution's, is a matrix of its outputs by all others. Weights that are no
matrices, such as biases, are summed as by task arithmetic. Options out of range raise OutOfRange.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch

from robogauntlet_mergevla.merging.elementwise import PUBLISHED_TRIM, elect, trimmed
from robogauntlet_mergevla.merging.errors import check_range
from robogauntlet_mergevla.merging.task_vectors import TaskVector, TaskVectors, names_of, order_free_sum, stack

EXACT = 1e-12
"""Cut-off of the least interference: singular values below it are rounding errors of float64."""


def _matrices(task_vectors: TaskVectors) -> dict[str, torch.Tensor]:
    """Weight name to the experts' deltas as matrices, shape (experts, outputs, inputs), for all that are matrices."""
    stacks = {name: stack(task_vectors, name) for name in names_of(task_vectors)}
    return {name: deltas.flatten(2) for name, deltas in stacks.items() if deltas.ndim > 2 and deltas.numel()}


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
    return _knots(task_vectors, cutoff, lambda parts: {name: order_free_sum(part) for name, part in parts.items()})


def knots_ties(
    task_vectors: TaskVectors, *, cutoff: float = 1e-4, trim: float = PUBLISHED_TRIM
) -> dict[str, torch.Tensor]:
    """Merge by published TIES in the space that the experts share (KnOTS-TIES, arXiv 2410.19735).

    As `knots`, but what is merged are the S V_m^T of all matrices together, by `ties_published`. The paper then scales
    the result by a value that it searches for: see `Recipe.alpha`.

    `cutoff` as for `knots`; `trim`, in [0, 1), is the share of each expert's entries that is set to zero.
    """
    check_range("trim", trim, 0, 1, closed="[)")

    def merge(parts: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        count = len(task_vectors)
        cut = [trimmed({name: part[expert] for name, part in parts.items()}, trim) for expert in range(count)]
        return elect({name: torch.stack([vector[name] for vector in cut]) for name in parts}, average=True)

    return _knots(task_vectors, cutoff, merge)


def _knots(
    task_vectors: TaskVectors,
    cutoff: float,
    merge: Callable[[dict[str, torch.Tensor]], dict[str, torch.Tensor]],
) -> dict[str, torch.Tensor]:
    """Merge S V_m^T of each matrix, shape (experts, r, inputs), and multiply U back."""
    check_range("cutoff", cutoff, 0, float("inf"), closed="[)")
    bases, parts = {}, {}
    for name, deltas in _matrices(task_vectors).items():
        experts, outputs, inputs = deltas.shape
        joint = deltas.to(torch.float64).transpose(0, 1).reshape(outputs, experts * inputs)
        u, s, vh = torch.linalg.svd(joint, full_matrices=False)
        kept = s > cutoff
        bases[name] = u[:, kept]
        parts[name] = (s[kept, None] * vh[kept]).reshape(-1, experts, inputs).transpose(0, 1)
    aligned = merge(parts)
    merged = {}
    for name in names_of(task_vectors):
        deltas = stack(task_vectors, name)
        whole = bases[name] @ aligned[name] if name in bases else order_free_sum(deltas)
        merged[name] = whole.float().reshape(deltas.shape[1:])
    return merged


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


def wudi_adam(task_vectors: TaskVectors, *, steps: int = 300, learning_rate: float = 1e-5) -> dict[str, torch.Tensor]:
    """Descend the interference that `wudi` minimises by Adam from the sum, as published (arXiv 2503.08099).

    The published rate suits deltas of large networks: how far it came is `interference_reduction`. `steps`, at least 0,
    and `learning_rate`, greater than 0, are Adam's.
    """
    check_range("steps", steps, 0, float("inf"), closed="[)", whole=True)
    check_range("learning_rate", learning_rate, 0, float("inf"))
    return _merged_by(task_vectors, lambda deltas: _wudi_adam(deltas, steps, learning_rate))


def _wudi_adam(deltas: torch.Tensor, steps: int, learning_rate: float) -> torch.Tensor:
    start = order_free_sum(deltas)
    # The gradient is affine in the displacement from the start. In this form it is exactly zero for a single expert;
    # in any other, Adam would follow rounding errors, since it ignores their size.
    gradient, gram = (tensor.float() for tensor in _interference_gradient(start, deltas))
    moved = torch.nn.Parameter(torch.zeros_like(gradient))
    adam = torch.optim.Adam([moved], lr=learning_rate)
    for _ in range(steps):
        moved.grad = 2 * (gradient + moved.detach() @ gram)
        adam.step()
    return start + moved.detach()


def interference_reduction(task_vectors: TaskVectors, merged: TaskVector) -> float:
    """How far a merge lowers the interference with the experts: 0 for their sum, 1 for the least that is possible.

    Over all matrices together, see `wudi`. Negative if the interference is greater than that of the sum; 1 if the sum
    has the least already.
    """
    at_sum = at_merged = least = 0.0
    for name, deltas in _matrices(task_vectors).items():
        start = order_free_sum(deltas)
        at_sum += _interference(start, deltas)
        at_merged += _interference(merged[name].to(torch.float64).flatten(1), deltas)
        least += _interference(_wudi(deltas, EXACT), deltas)
    return (at_sum - at_merged) / (at_sum - least) if at_sum > least else 1.0


def _interference(delta: torch.Tensor, deltas: torch.Tensor) -> float:
    """sum_m ||(delta - tau_m) tau_m^T||_F^2 / ||tau_m||_F^2, in float64."""
    return sum(((delta - own) @ unit.T).square().sum().item() for own, unit in _with_directions(deltas))


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
