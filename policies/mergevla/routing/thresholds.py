"""What held-out frames of known tasks fix: a temperature, and from where on a task counts as unknown."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from policies.mergevla.routing.contract import RoutingError

COVERAGE = 0.95
"""Share of known tasks' sightings that a rejection threshold lets pass."""
HOTTEST = 1e3


def temperature_of(logits: Tensor, truth: Tensor) -> float:
    """The temperature with the smallest mean negative log-likelihood (C. Guo et al., arXiv 1706.04599).

    At least 1: held-out frames that are all told apart would drive it to 0, and with it any doubt.

    Args:
        logits: Shape (n, classes), n >= 1.
        truth: Index of the true class, shape (n,).
    """
    from scipy.optimize import minimize_scalar

    def loss(log_temperature: float) -> float:
        return float(torch.nn.functional.cross_entropy(logits / math.exp(log_temperature), truth))

    found = minimize_scalar(loss, bounds=(0.0, math.log(HOTTEST)), method="bounded").x
    return math.exp(found) if loss(found) < loss(0.0) else 1.0


def conformal_threshold(scores: Tensor, coverage: float = COVERAGE) -> float:
    """The smallest held-out score that a new one of the same kind stays under with probability `coverage`.

    The ceil((n + 1) coverage)-th smallest of n (split conformal prediction: V. Vovk, A. Gammerman and G. Shafer,
    "Algorithmic Learning in a Random World", 2005). Too few scores for that (n < 19 at 0.95): the largest.

    Raises:
        RoutingError: There are no scores.
    """
    if len(scores) == 0:
        raise RoutingError("expected held-out first frames for a rejection threshold, got none")
    rank = min(math.ceil((len(scores) + 1) * coverage), len(scores))
    return float(np.sort(scores.double().numpy())[rank - 1])
