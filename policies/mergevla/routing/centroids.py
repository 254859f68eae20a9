"""The nearest class mean of the base's mean-pooled hidden states: the control for the Gaussian router."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from robogauntlet.policies.mergevla.routing.calibration import conformal_threshold
from robogauntlet.policies.mergevla.routing.features import FeatureSpec, LabelledFeatures, check_held_out
from robogauntlet.policies.mergevla.routing.fitted_router import RouterFit, check_features, shared_fields


class Centroids(RouterFit):
    """Class means in the space of the features."""

    def distances(self, features: Tensor) -> Tensor:
        """Euclidean distance of features (n, d) to each class, shape (n, experts), float64."""
        check_features(features, self.centres.shape[1])
        return (features.double()[:, None] - self.centres.double()).norm(dim=-1)

    def scores(self, features: Tensor) -> Tensor:
        """Negative distances, shape (n, experts)."""
        return -self.distances(features)

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> Centroids:
        """Read what `as_tensors` wrote.

        Raises:
            RoutingError: A tensor is missing, of another shape, or not finite.
        """
        return cls(**shared_fields(tensors))


def fit_centroids(frames: LabelledFeatures, held_out: LabelledFeatures, feature_spec: FeatureSpec) -> Centroids:
    """Fit class means to `frames` and the threshold to `held_out` features.

    Raises:
        RoutingError: Experts without frames or held-out ones.
    """
    check_held_out(frames, held_out)
    centres = torch.stack([frames.of(expert).double().mean(dim=0) for expert in frames.experts]).float()
    fitted = Centroids(experts=frames.experts, centres=centres, feature_spec=feature_spec)
    return replace(fitted, threshold=conformal_threshold(fitted.unknown(held_out.features)))
