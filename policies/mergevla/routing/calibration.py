"""Calibration on held-out first observations of known tasks: temperature and rejection threshold."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from robogauntlet.policies.mergevla.routing.contract import RoutingError

COVERAGE = 0.95
"""Share of known tasks' observations that a rejection threshold accepts."""
MAX_TEMPERATURE = 1e3


def temperature_of(logits: Tensor, truth: Tensor) -> float:
    """Return the temperature of the smallest mean negative log-likelihood (C. Guo et al., arXiv 1706.04599).

    It is at least 1: perfectly separated held-out observations would drive it to 0 and the router to certainty.

    Args:
        logits: Shape (n, classes), n >= 1.
        truth: Index of the true class, shape (n,).
    """
    from scipy.optimize import minimize_scalar

    def loss(log_temperature: float) -> float:
        return float(torch.nn.functional.cross_entropy(logits / math.exp(log_temperature), truth))

    best = minimize_scalar(loss, bounds=(0.0, math.log(MAX_TEMPERATURE)), method="bounded").x
    return math.exp(best) if loss(best) < loss(0.0) else 1.0


def conformal_threshold(scores: Tensor, coverage: float = COVERAGE) -> float:
    """Return the smallest held-out score that a new score of the same kind does not exceed with probability `coverage`.

    It is the ceil((n + 1) coverage)-th smallest of n (split conformal prediction: V. Vovk, A. Gammerman and G. Shafer,
    "Algorithmic Learning in a Random World", 2005), or the largest if there are too few (n < 19 at 0.95).

    Raises:
        RoutingError: There are no scores.
    """
    if len(scores) == 0:
        raise RoutingError("expected held-out first observations for a rejection threshold, got none")
    rank = min(math.ceil((len(scores) + 1) * coverage), len(scores))
    return float(np.sort(scores.double().numpy())[rank - 1])
