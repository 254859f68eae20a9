"""What the fitted routers know of a sighting: hidden states of the frozen base, from one pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import torch
from torch import Tensor

from policies.mergevla.routing.contract import Candidates, RoutingError, Sighting, hidden_states


class Pooling(StrEnum):
    """What becomes of the patches."""

    FLAT = "flat"
    """Every patch keeps its place: where things lie counts."""
    MEAN = "mean"
    """Their mean."""


@dataclass(frozen=True)
class Reading:
    """What is taken of the base's hidden states."""

    sees_instruction: bool = True
    """False blanks the instruction."""
    layer: int = -1
    """Index of the hidden states, -1 for the last."""
    pooling: Pooling = Pooling.MEAN
    """Of the patches. Their mean notices an unknown task better: flat, the patches' many numbers drown the rest."""

    def as_tensor(self) -> Tensor:
        """As three whole numbers; `from_tensor` is the inverse."""
        return torch.tensor([int(self.sees_instruction), self.layer, list(Pooling).index(self.pooling)])

    @classmethod
    def from_tensor(cls, came: Tensor | None) -> Reading:
        """What `as_tensor` wrote.

        Raises:
            RoutingError: It is something else.
        """
        if came is None or came.dtype != torch.int64 or came.shape != (3,) or not 0 <= came[2] < len(Pooling):
            raise RoutingError(f"expected three whole numbers that say what is read, got {came}")
        return cls(bool(came[0]), int(came[1]), list(Pooling)[int(came[2])])


@dataclass(frozen=True, eq=False)
class Labelled:
    """Features of sightings whose task is known."""

    features: Tensor
    """Shape (n, d)."""
    labels: tuple[str, ...]
    """Expert's name for each of the n."""

    def __post_init__(self) -> None:
        if self.features.ndim != 2 or len(self.features) != len(self.labels):
            raise RoutingError(
                f"expected features of shape ({len(self.labels)}, d), one row per label, got {(*self.features.shape,)}"
            )
        if not torch.isfinite(self.features).all():
            raise RoutingError("expected finite features, got NaN or infinity")

    @property
    def experts(self) -> tuple[str, ...]:
        """The names that occur, sorted."""
        return tuple(sorted(set(self.labels)))

    def of(self, expert: str) -> Tensor:
        """The features of one expert's sightings."""
        return self.features[[i for i, label in enumerate(self.labels) if label == expert]]

    def without(self, expert: str) -> Labelled:
        """The same without one expert's."""
        kept = [i for i, label in enumerate(self.labels) if label != expert]
        return Labelled(self.features[kept], tuple(self.labels[i] for i in kept))


def features_of(candidates: Candidates, sightings: Sequence[Sighting], reading: Reading) -> Tensor:
    """Features of sightings from one pass of the base.

    Args:
        candidates: Of which only the base is run.
        sightings: Of the architecture's cameras and image size.
        reading: What to take of the patches' states; the mean of h_A follows.

    Returns:
        Shape (n, d), float32, on the CPU.

    Raises:
        RoutingError: Images of another shape, or no such layer.
    """
    parts = []
    for hidden in hidden_states(candidates, None, sightings, sees_instruction=reading.sees_instruction):
        layers = len(hidden.task)
        if not -layers <= reading.layer < layers:
            raise RoutingError(f"expected a layer from {-layers} to {layers - 1}, got {reading.layer}")
        task = hidden.task[reading.layer]
        seen = task.flatten(1) if reading.pooling is Pooling.FLAT else task.mean(dim=1)
        parts.append(torch.cat([seen, hidden.action[reading.layer].mean(dim=1)], dim=1).float().cpu())
    return torch.cat(parts) if parts else torch.empty(0, 0)


def labelled(candidates: Candidates, frames: Mapping[str, Sequence[Sighting]], reading: Reading) -> Labelled:
    """Features of each expert's sightings, see `features_of`.

    Raises:
        RoutingError: An expert has no sightings.
    """
    for expert, sightings in frames.items():
        if not sightings:
            raise RoutingError(f"expected first frames of expert {expert}, got none")
    sightings = [sighting for expert in frames for sighting in frames[expert]]
    labels = tuple(expert for expert in frames for _ in frames[expert])
    return Labelled(features_of(candidates, sightings, reading), labels)


def check_held_out(frames: Labelled, held_out: Labelled) -> None:
    """Refuse held-out frames of other experts than the classes are fitted to.

    Raises:
        RoutingError: They are, or there are none at all.
    """
    if not frames.labels or held_out.experts != frames.experts:
        wanted, came = (", ".join(data.experts) for data in (frames, held_out))
        raise RoutingError(f"expected held-out first frames of {wanted or 'some experts'}, got {came or 'none'}")
