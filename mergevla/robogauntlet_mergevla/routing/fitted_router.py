"""Routers that are fitted to first observations: one pass of the base, then a classifier of its hidden states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Self

import numpy as np
import torch
from torch import Tensor

from robogauntlet.policies.contract import Routing
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.routing.contract import (
    FirstObservation,
    RoutingError,
    answer,
    check_experts,
)
from robogauntlet_mergevla.routing.features import FeatureSpec, LabelledFeatures, check_held_out, features_of

COVERAGE = 0.95
"""Share of known tasks' observations that a rejection threshold accepts."""
MAX_TEMPERATURE = 1e3


@dataclass(frozen=True, eq=False, kw_only=True)
class RouterFit:
    """A fitted classifier of features: the nearest class mean, by Euclidean distance to one centre per expert.

    On the base's mean-pooled hidden states it is the control for the Gaussian router.
    """

    experts: tuple[str, ...]
    """Sorted names of the classes: the experts' tasks, or the experts if it was fitted without tasks."""
    centres: Tensor
    """Class means, shape (experts, c)."""
    feature_spec: FeatureSpec
    threshold: float = 0.0
    """Distance to the nearest class above which a task counts as unknown."""

    def distances(self, features: Tensor) -> Tensor:
        """Distance of features (n, d) to each class, shape (n, experts), float64; RoutingError for another length."""
        check_features(features, self.centres.shape[1])
        return (features.double()[:, None] - self.centres.double()).norm(dim=-1)

    def scores(self, features: Tensor) -> Tensor:
        """Score of each expert, higher is likelier, for features (n, d): shape (n, experts). Negative distances."""
        return -self.distances(features)

    def joined(self, scores: Tensor) -> Tensor:
        """Score of an expert, shape (n,), from those of its tasks, shape (n, tasks): that of the likeliest."""
        return scores.amax(dim=1)

    def unknown(self, features: Tensor) -> Tensor:
        """Distance of features (n, d) to the nearest class (K. Lee et al., arXiv 1807.03888), shape (n,)."""
        return self.distances(features).amin(dim=1)

    def as_tensors(self) -> dict[str, Tensor]:
        """Return the fit as tensors, for a safetensors file."""
        return {
            "experts": torch.tensor(list("\n".join(self.experts).encode()), dtype=torch.uint8),
            "reading": self.feature_spec.as_tensor(),
            "centres": self.centres,
            "threshold": torch.tensor(self.threshold, dtype=torch.float64),
        }

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor], width: int | None = None, **fields: Tensor | float) -> Self:
        """Read what `as_tensors` wrote. Raises RoutingError if a tensor is missing, of another shape, or not finite.

        `width` is the expected length of a centre, `fields` are those of a subclass.
        """
        experts = read_names(tensors, "experts")
        return cls(
            experts=experts,
            centres=read_tensor(tensors, "centres", (len(experts), width)),
            feature_spec=FeatureSpec.from_tensor(tensors.get("reading")),
            threshold=read_number(tensors, "threshold"),
            **fields,
        )


def fit_centroids(frames: LabelledFeatures, held_out: LabelledFeatures, feature_spec: FeatureSpec) -> RouterFit:
    """Fit class means to `frames` and the threshold to `held_out` features.

    Raises RoutingError for experts without frames or held-out ones.
    """
    check_held_out(frames, held_out)
    centres = torch.stack([frames.of(expert).double().mean(dim=0) for expert in frames.experts]).float()
    fitted = RouterFit(experts=frames.experts, centres=centres, feature_spec=feature_spec)
    return replace(fitted, threshold=conformal_threshold(fitted.unknown(held_out.features)))


def check_features(features: Tensor, width: int) -> None:
    """Raise RoutingError unless the features are of shape (n, width)."""
    if features.ndim != 2 or features.shape[1] != width:
        raise RoutingError(f"expected features of shape (n, {width}), got {tuple(features.shape)}")


class FittedRouter:
    """Routes by a classifier that was fitted to the model's base and experts."""

    def __init__(self, name: str, fitted: RouterFit) -> None:
        self.name = name
        self._fitted = fitted
        self.sees_instruction = fitted.feature_spec.sees_instruction

    def passes(self, experts: int) -> int:
        """One pass of the base, for any number of experts."""
        return 1

    def route(self, observations: Sequence[FirstObservation], model: MergedModel) -> list[Routing]:
        """Route each observation, in order.

        Raises PolicyError for images of another shape, or other experts than those that the router was fitted to.
        """
        fitted = self._fitted
        of_expert = dict(model.tasks)
        if set(fitted.experts) == set(model.experts):
            of_expert = {expert: (expert,) for expert in model.experts}
        check_experts(self.name, fitted.experts, tuple(chain.from_iterable(of_expert.values())))
        if not observations:
            return []
        features = features_of(model, observations, fitted.feature_spec)
        scores, unknown = fitted.scores(features), fitted.unknown(features).tolist()
        by_expert = {
            expert: fitted.joined(scores[:, [fitted.experts.index(name) for name in classes]]).tolist()
            for expert, classes in of_expert.items()
        }
        return [
            answer({expert: values[row] for expert, values in by_expert.items()}, distance, fitted.threshold)
            for row, distance in enumerate(unknown)
        ]


def temperature_of(logits: Tensor, truth: Tensor) -> float:
    """Return the temperature of the smallest mean negative log-likelihood (C. Guo et al., arXiv 1706.04599).

    It is at least 1: perfectly separated held-out observations would drive it to 0 and the router to certainty. Logits
    are of shape (n, classes), n >= 1; `truth` holds the index of the true class, shape (n,).
    """
    from scipy.optimize import minimize_scalar

    def loss(log_temperature: float) -> float:
        return float(torch.nn.functional.cross_entropy(logits / math.exp(log_temperature), truth))

    best = minimize_scalar(loss, bounds=(0.0, math.log(MAX_TEMPERATURE)), method="bounded").x
    return math.exp(best) if loss(best) < loss(0.0) else 1.0


def conformal_threshold(scores: Tensor, coverage: float = COVERAGE) -> float:
    """Return the smallest held-out score that a new score of the same kind does not exceed with probability `coverage`.

    It is the ceil((n + 1) coverage)-th smallest of n (split conformal prediction: V. Vovk, A. Gammerman and G. Shafer,
    "Algorithmic Learning in a Random World", 2005), or the largest if there are too few (n < 19 at 0.95). Raises
    RoutingError without scores.
    """
    if len(scores) == 0:
        raise RoutingError("expected held-out first observations for a rejection threshold, got none")
    rank = min(math.ceil((len(scores) + 1) * coverage), len(scores))
    return float(np.sort(scores.double().numpy())[rank - 1])


def read_names(tensors: Mapping[str, Tensor], name: str) -> tuple[str, ...]:
    """Read names, the bytes of their lines. Raises RoutingError if they are missing or malformed."""
    tensor = tensors.get(name)
    if tensor is None or tensor.dtype != torch.uint8 or tensor.ndim != 1 or len(tensor) == 0:
        raise RoutingError(f"expected {name} as the bytes of their names, got {_described(tensor)}")
    try:
        return tuple(bytes(tensor.tolist()).decode().split("\n"))
    except UnicodeDecodeError:
        raise RoutingError(f"expected {name} as names in UTF-8, got other bytes") from None


def read_tensor(tensors: Mapping[str, Tensor], name: str, shape: tuple[int | None, ...]) -> Tensor:
    """Read a tensor of that name and shape, in which None stands for any length.

    Raises RoutingError if it is missing, has another shape, or is not finite.
    """
    tensor = tensors.get(name)
    fits = tensor is not None and tensor.ndim == len(shape) and tensor.is_floating_point()
    if tensor is None or not fits or any(n not in (None, got) for n, got in zip(shape, tensor.shape, strict=True)):
        expected = ", ".join("any" if length is None else str(length) for length in shape)
        raise RoutingError(f"expected {name} as numbers of shape ({expected}), got {_described(tensor)}")
    if not torch.isfinite(tensor).all():
        raise RoutingError(f"expected a finite {name}, got NaN or infinity")
    return tensor


def read_number(tensors: Mapping[str, Tensor], name: str) -> float:
    """Read a number; raises RoutingError as `read_tensor` does."""
    return float(read_tensor(tensors, name, ()))


def _described(tensor: Tensor | None) -> str:
    return "none" if tensor is None else f"{tuple(tensor.shape)} of {tensor.dtype}"
