"""The merge operators by name: each merges several task vectors into one."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any

import torch

from robogauntlet.policies.mergevla.merging.elementwise import dare, emr, mean, task_arithmetic, ties
from robogauntlet.policies.mergevla.merging.errors import MergeError, check_range
from robogauntlet.policies.mergevla.merging.signs import flat, magnitude
from robogauntlet.policies.mergevla.merging.spectral import knots, task_singular_vectors, wudi
from robogauntlet.policies.mergevla.merging.task_vectors import TaskVectors, check_task_vectors
from robogauntlet.suites.plugins import did_you_mean

Operator = Callable[..., dict[str, torch.Tensor]]
"""Takes the experts' task vectors, checked by `check_task_vectors`, and its options as keyword-only arguments. Returns
tau_merge in fp32."""
OPERATORS: Mapping[str, Operator] = MappingProxyType(
    {
        "mean": mean,
        "ta": task_arithmetic,
        "ties": ties,
        "dare": dare,
        "tsv": task_singular_vectors,
        "knots": knots,
        "wudi": wudi,
        "emr": emr,
        "magnitude": magnitude,
        "flat": flat,
    }
)
"""Every merge operator by name. The functions' docstrings name the papers."""


class UnknownOperator(MergeError):
    """Unknown merge operator, or unknown option of one."""


def find_operator(name: str, options: Iterable[str] = ()) -> Operator:
    """Return the operator of that name after checking the names of its options.

    Raises:
        UnknownOperator: Unknown operator or option.
    """
    if name not in OPERATORS:
        raise UnknownOperator(f"unknown merge operator '{name}'{did_you_mean(name, OPERATORS)}")
    known = inspect.getfullargspec(OPERATORS[name]).kwonlyargs
    for option in options:
        if option not in known:
            raise UnknownOperator(f"operator '{name}' has no option '{option}'; it has: {', '.join(known) or 'none'}")
    return OPERATORS[name]


def merge_task_vectors(
    operator: str, task_vectors: TaskVectors, *, alpha: float = 1.0, options: Mapping[str, Any] | None = None
) -> dict[str, torch.Tensor]:
    """tau_merge = alpha * R({tau_m}) (arXiv 2511.18810 equation 2).

    Args:
        operator: Name of R in `OPERATORS`.
        task_vectors: The experts' task vectors.
        alpha: Scale of the merged task vector, greater than 0; the paper's is 1.
        options: Options of the operator.

    Raises:
        UnknownOperator: Unknown operator or option.
        OutOfRange: alpha or an option is out of range.
        ExpertsDiffer: The task vectors do not fit each other.
    """
    chosen = find_operator(operator, options or {})
    check_range("alpha", alpha, 0, float("inf"))
    check_task_vectors(task_vectors)
    return {name: delta * alpha for name, delta in chosen(task_vectors, **(options or {})).items()}
