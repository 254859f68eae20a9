"""Our router's model: Gaussian classes with one shared covariance, calibrated on held-out first frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from policies.mergevla.routing.contract import RoutingError
from policies.mergevla.routing.features import Labelled, Reading, check_held_out
from policies.mergevla.routing.storage import names_from, names_tensor, number_from, tensor_from
from policies.mergevla.routing.thresholds import conformal_threshold, temperature_of

COMPONENTS = 256
SMALLEST_SPREAD = 1e-2
"""A feature counts as spread by at least this share of the features' root mean square deviation: dividing by less would
blow rounding errors up."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Which class a feature vector belongs to, how probably, and how far it is from all of them."""

    experts: tuple[str, ...]
    """Sorted."""
    mean: Tensor
    """Of the features, shape (d,)."""
    whitening: Tensor
    """From centred features to where each class has the covariance 1: principal axes of the standardised features,
    seen through a factor of the inverse of their covariance within classes, shape (c, d)."""
    centres: Tensor
    """Class means there, shape (experts, c)."""
    reading: Reading
    """What the features are."""
    temperature: float = 1.0
    threshold: float = 0.0
    """Distance above which a task counts as unknown."""

    def distances(self, features: Tensor) -> Tensor:
        """Mahalanobis distance of features (n, d) to each class, shape (n, experts), float64.

        Raises:
            RoutingError: Features of another length.
        """
        if features.ndim != 2 or features.shape[1] != len(self.mean):
            raise RoutingError(f"expected features of shape (n, {len(self.mean)}), got {tuple(features.shape)}")
        white = (features.double() - self.mean) @ self.whitening.double().mT
        return (white[:, None] - self.centres.double()).norm(dim=-1)

    def scores(self, features: Tensor) -> Tensor:
        """Log-probability of each class with equal priors at the temperature, shape (n, experts), float64."""
        return torch.log_softmax(self.distances(features).square() / (-2.0 * self.temperature), dim=1)

    def unknown(self, features: Tensor) -> Tensor:
        """Distance to the nearest class (K. Lee et al., arXiv 1807.03888), shape (n,)."""
        return self.distances(features).amin(dim=1)

    def as_tensors(self) -> dict[str, Tensor]:
        """All of it as tensors; `from_tensors` is the inverse."""
        return {
            "reading": self.reading.as_tensor(),
            "experts": names_tensor(self.experts),
            "mean": self.mean,
            "whitening": self.whitening,
            "centres": self.centres,
            "temperature": torch.tensor(self.temperature, dtype=torch.float64),
            "threshold": torch.tensor(self.threshold, dtype=torch.float64),
        }

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> Calibration:
        """The calibration that `as_tensors` wrote.

        Raises:
            RoutingError: A tensor is missing, of another shape, or not finite.
        """
        experts = names_from(tensors, "experts")
        mean = tensor_from(tensors, "mean", (None,))
        whitening = tensor_from(tensors, "whitening", (None, len(mean)))
        temperature = number_from(tensors, "temperature")
        if temperature <= 0:
            raise RoutingError(f"expected a temperature above 0, got {temperature:g}")
        return cls(
            experts,
            mean,
            whitening,
            tensor_from(tensors, "centres", (len(experts), len(whitening))),
            Reading.from_tensor(tensors.get("reading")),
            temperature,
            number_from(tensors, "threshold"),
        )


def fit(frames: Labelled, held_out: Labelled, reading: Reading, components: int = COMPONENTS) -> Calibration:
    """Fit the classes, then the temperature and the threshold.

    Args:
        frames: To fit the classes on.
        held_out: Of the same experts, to fit temperature and threshold on.
        reading: What the features are.
        components: Principal components at most.

    Raises:
        RoutingError: Experts without frames or held-out ones, or frames that are all the same.
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
    fitted = Calibration(experts, mean.float(), whitening.float(), centres.float(), reading)
    truth = torch.tensor([experts.index(label) for label in held_out.labels])
    logits = fitted.distances(held_out.features).square() / -2.0
    return replace(
        fitted,
        temperature=temperature_of(logits, truth),
        threshold=conformal_threshold(fitted.unknown(held_out.features)),
    )


def ledoit_wolf(residuals: Tensor) -> Tensor:
    """Covariance of centred rows, shrunk towards a multiple of the identity by the amount that the rows call for.

    O. Ledoit and M. Wolf, "A well-conditioned estimator for large-dimensional covariance matrices", J. Multivariate
    Anal. 88 (2004).

    Args:
        residuals: X, shape (n, p), n >= 1.

    Returns:
        Shape (p, p).
    """
    from sklearn import covariance

    estimate, _ = covariance.ledoit_wolf(residuals.numpy(), assume_centered=True)
    return torch.from_numpy(estimate)


def _principal_axes(centred: Tensor, most: int) -> Tensor:
    """Principal axes of the standardised data, divided by each feature's spread, so that they apply to the data itself.

    Shape (c, d), c at most `most` and the rank.
    """
    deviation = centred.square().mean(dim=0).sqrt()
    overall = deviation.square().mean().sqrt()
    if overall == 0:
        raise RoutingError("expected first frames that differ, got features that are all the same")
    spread = deviation.clamp(min=float(SMALLEST_SPREAD * overall))
    _, values, axes = torch.linalg.svd(centred / spread, full_matrices=False)
    rank = int((values > values[0] * 1e-6).sum())
    return axes[: min(most, rank)] / spread


def _cholesky(covariance: Tensor) -> Tensor:
    factor, failed = torch.linalg.cholesky_ex(covariance)
    if failed:
        raise RoutingError(
            "expected first frames that differ within a task, got the same one each time; give it more demonstrations"
        )
    return factor
