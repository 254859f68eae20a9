"""Task vectors: what fine-tuning added to each weight (arXiv 2511.18810 section 3, after arXiv 2212.04089)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial

import torch

from robogauntlet_mergevla.merging.errors import DifferentBases, ExpertsDiffer

FEW = 5
"""Experts that are sorted by comparing neighbours."""
Weights = Mapping[str, torch.Tensor]
"""Weight name to tensor."""
TaskVector = Mapping[str, torch.Tensor]
"""Weight name to what fine-tuning added to it, fp32, of the weight's shape."""
TaskVectors = Mapping[str, TaskVector]
"""Expert name to its task vector; all experts have the same names and shapes."""


class OnDemand(Mapping[str, torch.Tensor]):
    """Tensors by name that are made when they are asked for, so that of large ones only the latest is in memory."""

    def __init__(self, makers: Mapping[str, Callable[[], torch.Tensor]]) -> None:
        self._makers = makers
        self._latest: tuple[str, torch.Tensor] | None = None

    def __getitem__(self, name: str) -> torch.Tensor:
        if self._latest is None or self._latest[0] != name:
            maker, self._latest = self._makers[name], None
            self._latest = name, maker()
        return self._latest[1]

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)

    def __contains__(self, name: object) -> bool:
        return name in self._makers


def difference(ours: Weights, theirs: Weights) -> str | None:
    """Describe the first difference in names or shapes between two sets of weights; None if there is none."""
    for name in sorted(ours.keys() | theirs.keys()):
        if name not in theirs:
            return f"weight {name} is missing"
        if name not in ours:
            return f"weight {name} is unexpected"
        if ours[name].shape != theirs[name].shape:
            return f"weight {name}: expected shape {tuple(ours[name].shape)}, got {tuple(theirs[name].shape)}"
    return None


def check_task_vectors(task_vectors: TaskVectors) -> None:
    """Raise ExpertsDiffer without experts, if names or shapes differ, or a tensor is not fp32 or not finite."""
    if not task_vectors:
        raise ExpertsDiffer("expected at least one expert to merge, got none")
    first, reference = next(iter(task_vectors.items()))
    for expert, vector in task_vectors.items():
        if problem := difference(reference, vector):
            raise ExpertsDiffer(f"expert {expert} does not fit expert {first}: {problem}")
        for name, delta in vector.items():
            if delta.dtype != torch.float32:
                raise ExpertsDiffer(f"expert {expert}, weight {name}: expected torch.float32, got {delta.dtype}")
            if not torch.isfinite(delta).all():
                raise ExpertsDiffer(f"expert {expert}, weight {name}: expected finite numbers, got NaN or infinity")


def task_vector(tuned: Weights, base: Weights) -> TaskVector:
    """Theta_m - Theta_0 (arXiv 2511.18810 equation 1), in fp32, each when it is asked for.

    Raises ExpertsDiffer if names or shapes differ. Differences of weights that were rounded to bf16 lose small deltas:
    use `robogauntlet_mergevla.network.lora.lora_factors` for weights that were tuned by LoRA.
    """
    if problem := difference(base, tuned):
        raise ExpertsDiffer(f"the fine-tuned weights do not fit the base: {problem}")
    return OnDemand({name: partial(_difference, tuned[name], weight) for name, weight in base.items()})


def _difference(tuned: torch.Tensor, base: torch.Tensor) -> torch.Tensor:
    return tuned.to(torch.float32) - base.to(torch.float32)


def check_same_base(hashes: Mapping[str, str]) -> None:
    """Raise DifferentBases unless all experts (name to hash of its base) were fine-tuned from one base."""
    first, expected = next(iter(hashes.items()), ("", ""))
    for expert, found in hashes.items():
        if found != expected:
            raise DifferentBases(f"expected all experts from base {expected} of {first}, got {found} for {expert}")


def stack(task_vectors: TaskVectors, name: str) -> torch.Tensor:
    """Return all experts' deltas of one weight, shape (experts, *shape)."""
    return torch.stack([vector[name] for vector in task_vectors.values()])


def names_of(task_vectors: TaskVectors) -> tuple[str, ...]:
    """Return the weights' names, sorted."""
    return tuple(sorted(next(iter(task_vectors.values()))))


def as_rows(weight: torch.Tensor) -> torch.Tensor:
    """Return a weight as a matrix: its first axis by all others; a vector or number as one row."""
    return weight.flatten(1) if weight.ndim > 1 else weight.reshape(1, -1)


def order_free_sum(values: torch.Tensor) -> torch.Tensor:
    """Sum over the first axis in float64, bit-identical for any order of the experts.

    Sorting first costs little and makes sign elections, which depend on the last bit, repeatable. A few experts are
    sorted by comparing neighbours, several times faster than by torch's sort.
    """
    if not 1 < len(values) <= FEW:
        return values.sort(dim=0).values.to(torch.float64).sum(dim=0)
    rows = list(values)
    for last in range(len(rows) - 1, 0, -1):
        for place in range(last):
            lower, upper = rows[place : place + 2]
            rows[place], rows[place + 1] = torch.minimum(lower, upper), torch.maximum(lower, upper)
    return torch.stack(rows).to(torch.float64).sum(dim=0)


def rms(vector: TaskVector) -> float:
    """Root mean square of all entries; 0 without entries."""
    count = sum(delta.numel() for delta in vector.values())
    squares = math.fsum(delta.to(torch.float64).square().sum().item() for delta in vector.values())
    return math.sqrt(squares / count) if count else 0.0
