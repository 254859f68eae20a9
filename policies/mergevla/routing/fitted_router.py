"""Routers that are fitted to first observations: one pass of the base, then a classifier of its hidden states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from robogauntlet.policies.mergevla.routing.contract import (
    Candidates,
    FirstObservation,
    Routed,
    RoutingError,
    answer,
    check_experts,
)
from robogauntlet.policies.mergevla.routing.features import FeatureSpec, features_of
from robogauntlet.policies.mergevla.routing.tensor_codec import decode_names, encode_names, read_number, read_tensor


@dataclass(frozen=True, eq=False, kw_only=True)
class RouterFit:
    """A fitted classifier of features with one centre per expert."""

    experts: tuple[str, ...]
    """Sorted names."""
    centres: Tensor
    """Class means, shape (experts, c)."""
    feature_spec: FeatureSpec
    threshold: float = 0.0
    """Distance to the nearest class above which a task counts as unknown."""

    def distances(self, features: Tensor) -> Tensor:
        """Distance of features (n, d) to each class, shape (n, experts), float64.

        Raises:
            RoutingError: Features of another length.
        """
        raise NotImplementedError

    def scores(self, features: Tensor) -> Tensor:
        """Score of each expert, higher is likelier, for features (n, d): shape (n, experts)."""
        raise NotImplementedError

    def unknown(self, features: Tensor) -> Tensor:
        """Distance of features (n, d) to the nearest class (K. Lee et al., arXiv 1807.03888), shape (n,)."""
        return self.distances(features).amin(dim=1)

    def as_tensors(self) -> dict[str, Tensor]:
        """Return the fit as tensors, for a safetensors file."""
        return {
            "experts": encode_names(self.experts),
            "reading": self.feature_spec.as_tensor(),
            "centres": self.centres,
            "threshold": torch.tensor(self.threshold, dtype=torch.float64),
        }


def shared_fields(tensors: Mapping[str, Tensor], width: int | None = None) -> dict[str, Any]:
    """Read the fields of `RouterFit` that `as_tensors` wrote; `width` is the expected length of a centre.

    Raises:
        RoutingError: A tensor is missing, of another shape, or not finite.
    """
    experts = decode_names(tensors, "experts")
    return {
        "experts": experts,
        "centres": read_tensor(tensors, "centres", (len(experts), width)),
        "feature_spec": FeatureSpec.from_tensor(tensors.get("reading")),
        "threshold": read_number(tensors, "threshold"),
    }


def check_features(features: Tensor, width: int) -> None:
    """Refuse features of another shape than (n, width).

    Raises:
        RoutingError: They have another shape.
    """
    if features.ndim != 2 or features.shape[1] != width:
        raise RoutingError(f"expected features of shape (n, {width}), got {tuple(features.shape)}")


class FittedRouter:
    """Routes by a fit to the candidates' base and experts."""

    def __init__(self, name: str, fitted: RouterFit) -> None:
        self.name = name
        self._fitted = fitted
        self.sees_instruction = fitted.feature_spec.sees_instruction

    def passes(self, experts: int) -> int:
        """One pass of the base, for any number of experts."""
        return 1

    def route(self, observations: Sequence[FirstObservation], candidates: Candidates) -> list[Routed]:
        """Route each observation, in order.

        Raises:
            PolicyError: Images of another shape, or other experts than those that the router was fitted to.
        """
        fitted = self._fitted
        check_experts(self.name, fitted.experts, candidates.experts)
        if not observations:
            return []
        features = features_of(candidates, observations, fitted.feature_spec)
        scores, unknown = fitted.scores(features).tolist(), fitted.unknown(features).tolist()
        return [
            answer(dict(zip(fitted.experts, row, strict=True)), distance, fitted.threshold)
            for row, distance in zip(scores, unknown, strict=True)
        ]
