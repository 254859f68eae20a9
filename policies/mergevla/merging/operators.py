"""The merge operators by name: how several task vectors become one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any

import torch

from policies.mergevla.merging.elementwise import dare, emr, mean, task_arithmetic, ties
from policies.mergevla.merging.errors import MergeError, check_range
from policies.mergevla.merging.signs import flat, magnitude
from policies.mergevla.merging.spectral import knots, task_singular_vectors, wudi
from policies.mergevla.merging.taus import Taus


class UnknownOperator(MergeError):
    """There is no such merge operator, or it has no such option."""


@dataclass(frozen=True)
class Operator:
    """A merge operator."""

    name: str
    summary: str
    arxiv: str
    """Number of the paper that describes it."""
    merge: Callable[..., dict[str, torch.Tensor]]
    """Takes the experts' task vectors and the options by name; gives tau_merge in fp32."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Option name to what it means. Anything else is an error."""


_ALL = (
    Operator("mean", "uniform mean of the deltas", "2203.05482", mean),
    Operator("ta", "task arithmetic: sum of the deltas", "2212.04089", task_arithmetic),
    Operator(
        "ties",
        "elect a sign per entry, sum the deltas that agree",
        "2306.01708",
        ties,
        {"trim": "share of each expert's smallest entries dropped first, in [0, 1), default 0"},
    ),
    Operator(
        "dare",
        "drop deltas at random, rescale the rest, sum",
        "2311.03099",
        dare,
        {"drop": "probability of dropping, in [0, 1), default 0.9", "seed": "of the draws, default 0"},
    ),
    Operator("tsv", "keep 1/M of the singular triplets, orthogonalise", "2412.00081", task_singular_vectors),
    Operator(
        "knots",
        "merge in the space of a joint singular value decomposition",
        "2410.19735",
        knots,
        {
            "aligned": "ties (published, the default) or sum (MergeVLA's code, which is task arithmetic)",
            "cutoff": "singular values up to here are left out, default 1e-4",
        },
    ),
    Operator(
        "wudi",
        "minimise interference from the sum by Adam",
        "2503.08099",
        wudi,
        {"steps": "of Adam, default 300", "learning_rate": "of Adam, default 1e-5"},
    ),
    Operator("emr", "elected sign, greatest magnitude that agrees", "2405.17461", emr),
    Operator(
        "magnitude", "magnitudes that fit all experts best, row by row; for masks 'signs'", "2402.10193", magnitude
    ),
    Operator("flat", "one magnitude per row: with masks 'signs' nothing is shared", "2402.10193", flat),
)
OPERATORS: Mapping[str, Operator] = MappingProxyType({operator.name: operator for operator in _ALL})
"""Every merge operator by name."""


def find_operator(name: str) -> Operator:
    """The operator of that name.

    Raises:
        UnknownOperator: There is none.
    """
    if name not in OPERATORS:
        near = get_close_matches(name, OPERATORS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(OPERATORS)}"
        raise UnknownOperator(f"unknown merge operator '{name}'; {hint}")
    return OPERATORS[name]


def operator_with(name: str, options: Iterable[str]) -> Operator:
    """The operator of that name, if it has these options.

    Raises:
        UnknownOperator: There is none, or it has no such option.
    """
    found = find_operator(name)
    for option in options:
        if option not in found.options:
            known = ", ".join(found.options) or "none"
            raise UnknownOperator(f"operator '{name}' has no option '{option}'; it has: {known}")
    return found


def merge_taus(
    operator: str, taus: Taus, *, alpha: float = 1.0, options: Mapping[str, Any] | None = None
) -> dict[str, torch.Tensor]:
    """tau_merge = alpha * R({tau_m}) (arXiv 2511.18810 equation 2).

    Args:
        operator: Name of R, out of `OPERATORS`.
        taus: The experts' task vectors.
        alpha: Scale of the merged task vector, greater than 0; the paper's is 1.
        options: Of the operator.

    Raises:
        UnknownOperator: There is no such operator, or it has no such option.
        OutOfRange: alpha or an option is out of range.
        ExpertsDiffer: The task vectors do not fit each other.
    """
    found = operator_with(operator, options or {})
    check_range("alpha", alpha, 0, float("inf"))
    return {name: delta * alpha for name, delta in found.merge(taus, **(options or {})).items()}
