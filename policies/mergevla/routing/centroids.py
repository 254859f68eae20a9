"""The simplest thing to fit, a control: the nearest class mean of the base's mean-pooled hidden states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from policies.mergevla.routing.contract import RoutingError
from policies.mergevla.routing.features import Labelled, Reading, check_held_out
from policies.mergevla.routing.storage import names_from, names_tensor, number_from, tensor_from
from policies.mergevla.routing.thresholds import conformal_threshold


@dataclass(frozen=True, eq=False)
class Centroids:
    """Class means."""

    experts: tuple[str, ...]
    """Sorted."""
    centres: Tensor
    """Shape (experts, d)."""
    reading: Reading
    """What the features are."""
    threshold: float = 0.0
    """Distance above which a task counts as unknown."""

    def distances(self, features: Tensor) -> Tensor:
        """Euclidean distance of features (n, d) to each class, shape (n, experts), float64.

        Raises:
            RoutingError: Features of another length.
        """
        width = self.centres.shape[1]
        if features.ndim != 2 or features.shape[1] != width:
            raise RoutingError(f"expected features of shape (n, {width}), got {tuple(features.shape)}")
        return (features.double()[:, None] - self.centres.double()).norm(dim=-1)

    def scores(self, features: Tensor) -> Tensor:
        """Negative distances, shape (n, experts)."""
        return -self.distances(features)

    def unknown(self, features: Tensor) -> Tensor:
        """Distance to the nearest class, shape (n,)."""
        return self.distances(features).amin(dim=1)

    def as_tensors(self) -> dict[str, Tensor]:
        """All of it as tensors; `from_tensors` is the inverse."""
        return {
            "experts": names_tensor(self.experts),
            "reading": self.reading.as_tensor(),
            "centres": self.centres,
            "threshold": torch.tensor(self.threshold, dtype=torch.float64),
        }

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> Centroids:
        """The centroids that `as_tensors` wrote.

        Raises:
            RoutingError: A tensor is missing, of another shape, or not finite.
        """
        experts = names_from(tensors, "experts")
        centres = tensor_from(tensors, "centres", (len(experts), None))
        return cls(experts, centres, Reading.from_tensor(tensors.get("reading")), number_from(tensors, "threshold"))


def fit_centres(frames: Labelled, held_out: Labelled, reading: Reading) -> Centroids:
    """Class means of frames, and the threshold from held-out ones.

    Raises:
        RoutingError: Experts without frames or held-out ones.
    """
    check_held_out(frames, held_out)
    centres = torch.stack([frames.of(expert).double().mean(dim=0) for expert in frames.experts]).float()
    fitted = Centroids(frames.experts, centres, reading)
    return replace(fitted, threshold=conformal_threshold(fitted.unknown(held_out.features)))
