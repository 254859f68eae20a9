"""The simplest fitted router, a control: the nearest class mean of the base's mean-pooled hidden states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from policies.mergevla.routing.contract import Candidates, Routed, RoutingError, Sighting, answer, check_experts
from policies.mergevla.routing.features import Labelled, Reading, check_held_out, features_of, labelled
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


def fit_centroids(
    candidates: Candidates,
    frames: Mapping[str, Sequence[Sighting]],
    held_out: Mapping[str, Sequence[Sighting]],
    *,
    sees_instruction: bool,
) -> Centroids:
    """Fit the nearest-centroid router; arguments and errors as `fit_calibration`."""
    reading = Reading(sees_instruction)
    return fit_centres(labelled(candidates, frames, reading), labelled(candidates, held_out, reading), reading)


class NearestCentroidRouter:
    """Scores are negative distances."""

    name = "nearest-centroid"

    def __init__(self, centroids: Centroids) -> None:
        """Args: centroids: Fitted to the candidates' base and experts."""
        self._centroids = centroids
        self.sees_instruction = centroids.reading.sees_instruction

    def passes(self, experts: int) -> int:
        """One, of the base."""
        return 1

    def route(self, sightings: Sequence[Sighting], candidates: Candidates) -> list[Routed]:
        """An answer for each sighting, in order.

        Raises:
            PolicyError: Images of another shape, or other experts than those that the router was fitted to.
        """
        known = self._centroids
        check_experts(self.name, known.experts, candidates.experts)
        if not sightings:
            return []
        distances = known.distances(features_of(candidates, sightings, known.reading)).tolist()
        return [
            answer({expert: -d for expert, d in zip(known.experts, row, strict=True)}, min(row), known.threshold)
            for row in distances
        ]
