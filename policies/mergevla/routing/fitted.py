"""Routers that learn from first frames: one pass of the base, then whatever was fitted to its hidden states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from torch import Tensor

from policies.mergevla.routing.contract import Candidates, Routed, Sighting, answer, check_experts
from policies.mergevla.routing.features import Reading, features_of


class Fitted(Protocol):
    """What was fitted."""

    @property
    def experts(self) -> tuple[str, ...]:
        """Names, sorted."""

    @property
    def reading(self) -> Reading:
        """What the features are."""

    @property
    def threshold(self) -> float:
        """Of `unknown`, above which a task counts as unknown."""

    def scores(self, features: Tensor) -> Tensor:
        """Score of each expert, higher is likelier, for features (n, d): shape (n, experts)."""

    def unknown(self, features: Tensor) -> Tensor:
        """How unlike any known task features (n, d) are, shape (n,)."""

    def as_tensors(self) -> dict[str, Tensor]:
        """All of it, for a safetensors file."""


class FittedRouter:
    """Routes by what was fitted to the candidates' base and experts."""

    def __init__(self, name: str, fitted: Fitted) -> None:
        self.name = name
        self._fitted = fitted
        self.sees_instruction = fitted.reading.sees_instruction

    def passes(self, experts: int) -> int:
        """One, of the base, however many experts."""
        return 1

    def route(self, sightings: Sequence[Sighting], candidates: Candidates) -> list[Routed]:
        """An answer for each sighting, in order.

        Raises:
            PolicyError: Images of another shape, or other experts than those that the router was fitted to.
        """
        known = self._fitted
        check_experts(self.name, known.experts, candidates.experts)
        if not sightings:
            return []
        features = features_of(candidates, sightings, known.reading)
        scores, unknown = known.scores(features).tolist(), known.unknown(features).tolist()
        return [
            answer(dict(zip(known.experts, row, strict=True)), distance, known.threshold)
            for row, distance in zip(scores, unknown, strict=True)
        ]
