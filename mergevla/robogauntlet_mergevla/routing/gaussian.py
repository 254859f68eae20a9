"""The router `calibrated`: Gaussian classes with one shared covariance, calibrated on held-out first observations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from robogauntlet_mergevla.routing.contract import RoutingError
from robogauntlet_mergevla.routing.features import FeatureSpec, LabelledFeatures, check_held_out
from robogauntlet_mergevla.routing.fitted_router import (
    RouterFit,
    check_features,
    conformal_threshold,
    read_number,
    read_tensor,
    temperature_of,
)

COMPONENTS = 256
SMALLEST_SPREAD = 1e-2
"""Lower bound of a feature's standard deviation, as a share of the features' root mean square deviation: dividing by
less would amplify rounding errors."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GaussianRouterFit(RouterFit):
    """Gaussian classes with one shared covariance. `centres` are the class means after whitening."""

    mean: Tensor
    """Mean of the features, shape (d,)."""
    whitening: Tensor
    """Maps centred features to a space in which each class has unit covariance: principal axes of the standardised
    features times a factor of the inverse of their within-class covariance, shape (c, d)."""
    temperature: float = 1.0

    def distances(self, features: Tensor) -> Tensor:
        """Mahalanobis distance of features (n, d) to each class, shape (n, experts), float64."""
        check_features(features, len(self.mean))
        white = (features.double() - self.mean) @ self.whitening.double().mT
        return (white[:, None] - self.centres.double()).norm(dim=-1)

    def scores(self, features: Tensor) -> Tensor:
        """Log-probability of each class with equal priors at the temperature, shape (n, experts), float64."""
        return torch.log_softmax(self.distances(features).square() / (-2.0 * self.temperature), dim=1)

    def joined(self, scores: Tensor) -> Tensor:
        """Log-probability of an expert, shape (n,), from those of its tasks, shape (n, tasks)."""
        return torch.logsumexp(scores, dim=1)

    def as_tensors(self) -> dict[str, Tensor]:
        """Return the fit as tensors, for a safetensors file."""
        return super().as_tensors() | {
            "mean": self.mean,
            "whitening": self.whitening,
            "temperature": torch.tensor(self.temperature, dtype=torch.float64),
        }

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor], width: int | None = None, **fields: Tensor | float) -> Self:
        """Read what `as_tensors` wrote; see `RouterFit.from_tensors`."""
        mean = read_tensor(tensors, "mean", (None,))
        whitening = read_tensor(tensors, "whitening", (None, len(mean)))
        temperature = read_number(tensors, "temperature")
        if temperature <= 0:
            raise RoutingError(f"expected a temperature above 0, got {temperature:g}")
        return super().from_tensors(tensors, len(whitening), mean=mean, whitening=whitening, temperature=temperature)


def fit(
    frames: LabelledFeatures, held_out: LabelledFeatures, feature_spec: FeatureSpec, components: int = COMPONENTS
) -> GaussianRouterFit:
    """Fit the classes to `frames`, then the temperature and the threshold to `held_out` features of the same experts.

    `components` is the largest number of principal components. Raises RoutingError for experts without frames or
    held-out ones, or frames that are all the same.
    """
    experts = frames.experts
    check_held_out(frames, held_out)
    data = frames.features.double()
    mean = data.mean(dim=0)
    axes = _principal_axes(data - mean, components)
    projected = (data - mean) @ axes.mT
    classes = torch.tensor([experts.index(label) for label in frames.labels])
    centres = torch.stack([projected[classes == i].mean(dim=0) for i in range(len(experts))])
    covariance = ledoit_wolf(projected - centres[classes])
    # The factor of the inverse, from the factor of the covariance.
    precision = torch.linalg.inv(_cholesky(covariance))
    whitening, centres = precision @ axes, centres @ precision.mT
    fitted = GaussianRouterFit(
        experts=experts,
        centres=centres.float(),
        feature_spec=feature_spec,
        mean=mean.float(),
        whitening=whitening.float(),
    )
    truth = torch.tensor([experts.index(label) for label in held_out.labels])
    logits = fitted.distances(held_out.features).square() / -2.0
    return replace(
        fitted,
        temperature=temperature_of(logits, truth),
        threshold=conformal_threshold(fitted.unknown(held_out.features)),
    )


def ledoit_wolf(residuals: Tensor) -> Tensor:
    """Covariance (p, p) of centred rows (n, p), n >= 1, shrunk towards a multiple of the identity.

    The amount is optimal: O. Ledoit and M. Wolf, "A well-conditioned estimator for large-dimensional covariance
    matrices", J. Multivariate Anal. 88 (2004).
    """
    from sklearn import covariance

    estimate, _ = covariance.ledoit_wolf(residuals.numpy(), assume_centered=True)
    return torch.from_numpy(estimate)


def _principal_axes(centred: Tensor, limit: int) -> Tensor:
    """Principal axes of the standardised data, divided by each feature's spread, so that they apply to the data itself.

    Shape (c, d), c at most `limit` and the rank.
    """
    deviation = centred.square().mean(dim=0).sqrt()
    overall = deviation.square().mean().sqrt()
    if overall == 0:
        raise RoutingError("expected first observations that differ, got features that are all the same")
    spread = deviation.clamp(min=float(SMALLEST_SPREAD * overall))
    _, values, axes = torch.linalg.svd(centred / spread, full_matrices=False)
    rank = int((values > values[0] * 1e-6).sum())
    return axes[: min(limit, rank)] / spread


def _cholesky(covariance: Tensor) -> Tensor:
    factor, failed = torch.linalg.cholesky_ex(covariance)
    if failed:
        raise RoutingError(
            "expected first observations that differ within a task, got the same one each time; "
            "give it more demonstrations"
        )
    return factor
