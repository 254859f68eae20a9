"""Features of first observations for the fitted routers: hidden states of the frozen base, from one pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import torch
from torch import Tensor

from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError, hidden_states


class Pooling(StrEnum):
    """How the patches' hidden states become one vector."""

    FLAT = "flat"
    """Concatenated, so that positions count."""
    MEAN = "mean"


@dataclass(frozen=True)
class FeatureSpec:
    """Which of the base's hidden states are the features."""

    sees_instruction: bool = True
    """False blanks the instruction."""
    layer: int = -1
    """Index of the hidden states, -1 for the last."""
    pooling: Pooling = Pooling.MEAN
    """The mean detects an unknown task better: concatenated, the patches' many numbers outweigh the rest."""

    def as_tensor(self) -> Tensor:
        """Return the fields as three whole numbers; `from_tensor` is the inverse."""
        return torch.tensor([int(self.sees_instruction), self.layer, list(Pooling).index(self.pooling)])

    @classmethod
    def from_tensor(cls, fields: Tensor | None) -> FeatureSpec:
        """Read what `as_tensor` wrote. Raises RoutingError if the tensor is missing or malformed."""
        if fields is None or fields.dtype != torch.int64 or fields.shape != (3,) or not 0 <= fields[2] < len(Pooling):
            raise RoutingError(f"expected three whole numbers that describe the features, got {fields}")
        return cls(bool(fields[0]), int(fields[1]), list(Pooling)[int(fields[2])])


@dataclass(frozen=True, eq=False)
class LabelledFeatures:
    """Features of first observations whose task is known."""

    features: Tensor
    """Shape (n, d)."""
    labels: tuple[str, ...]
    """Class of each of the n, a task."""

    def __post_init__(self) -> None:
        if self.features.ndim != 2 or len(self.features) != len(self.labels):
            raise RoutingError(
                f"expected features of shape ({len(self.labels)}, d), one row per label, got {(*self.features.shape,)}"
            )
        if not torch.isfinite(self.features).all():
            raise RoutingError("expected finite features, got NaN or infinity")

    @property
    def experts(self) -> tuple[str, ...]:
        """Sorted names of the experts."""
        return tuple(sorted(set(self.labels)))

    def of(self, expert: str) -> Tensor:
        """The features of one expert's observations."""
        return self.features[[i for i, label in enumerate(self.labels) if label == expert]]

    def without(self, expert: str) -> LabelledFeatures:
        """The features of all other experts."""
        kept = [i for i, label in enumerate(self.labels) if label != expert]
        return LabelledFeatures(self.features[kept], tuple(self.labels[i] for i in kept))


def features_of(model: MergedModel, observations: Sequence[FirstObservation], feature_spec: FeatureSpec) -> Tensor:
    """Compute features (n, d), float32, on the CPU, from one pass of the base: the pooled h_T, then the mean of h_A.

    Raises RoutingError for images of another shape, or if there is no such layer.
    """
    parts = []
    for hidden in hidden_states(model, None, observations, sees_instruction=feature_spec.sees_instruction):
        layers = len(hidden.task)
        if not -layers <= feature_spec.layer < layers:
            raise RoutingError(f"expected a layer from {-layers} to {layers - 1}, got {feature_spec.layer}")
        task = hidden.task[feature_spec.layer]
        seen = task.flatten(1) if feature_spec.pooling is Pooling.FLAT else task.mean(dim=1)
        parts.append(torch.cat([seen, hidden.action[feature_spec.layer].mean(dim=1)], dim=1).float().cpu())
    return torch.cat(parts) if parts else torch.empty(0, 0)


def labelled_features(
    model: MergedModel, frames: Mapping[str, Sequence[FirstObservation]], feature_spec: FeatureSpec
) -> LabelledFeatures:
    """Compute the features of each expert's observations. Raises RoutingError if an expert has none."""
    for expert, observations in frames.items():
        if not observations:
            raise RoutingError(f"expected first observations of expert {expert}, got none")
    observations = [observation for expert in frames for observation in frames[expert]]
    labels = tuple(expert for expert in frames for _ in frames[expert])
    return LabelledFeatures(features_of(model, observations, feature_spec), labels)


def check_held_out(frames: LabelledFeatures, held_out: LabelledFeatures) -> None:
    """Raise RoutingError unless `frames` and held-out features are of the same experts, at least one."""
    if not frames.labels or held_out.experts != frames.experts:
        expected, given = (", ".join(data.experts) for data in (frames, held_out))
        raise RoutingError(
            f"expected held-out first observations of {expected or 'some experts'}, got {given or 'none'}"
        )
