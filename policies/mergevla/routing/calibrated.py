"""Our router: one pass of the base, Gaussian classes over its hidden states, and a say in whether it knows the task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from policies.mergevla.routing.contract import Candidates, Routed, Sighting, answer, check_experts
from policies.mergevla.routing.features import Pooling, Reading, features_of, labelled
from policies.mergevla.routing.gaussian import Calibration, fit


class CalibratedRouter:
    """Scores are log-probabilities; `unknown` is the Mahalanobis distance to the nearest task."""

    name = "calibrated"

    def __init__(self, calibration: Calibration) -> None:
        """Args: calibration: Fitted to the candidates' base and experts."""
        self._calibration = calibration
        self.sees_instruction = calibration.reading.sees_instruction

    def passes(self, experts: int) -> int:
        """One, of the base, however many experts."""
        return 1

    def route(self, sightings: Sequence[Sighting], candidates: Candidates) -> list[Routed]:
        """An answer for each sighting, in order.

        Raises:
            PolicyError: Images of another shape, or other experts than those that the router was fitted to.
        """
        known = self._calibration
        check_experts(self.name, known.experts, candidates.experts)
        if not sightings:
            return []
        features = features_of(candidates, sightings, known.reading)
        scores, unknown = known.log_posterior(features).tolist(), known.unknown(features).tolist()
        return [
            answer(dict(zip(known.experts, row, strict=True)), distance, known.threshold)
            for row, distance in zip(scores, unknown, strict=True)
        ]


def fit_calibration(
    candidates: Candidates,
    frames: Mapping[str, Sequence[Sighting]],
    held_out: Mapping[str, Sequence[Sighting]],
    *,
    sees_instruction: bool,
    layer: int = -1,
    pooling: Pooling = Pooling.MEAN,
) -> Calibration:
    """Fit the calibrated router.

    Args:
        candidates: Of which only the base is run.
        frames: Expert to first observations for its class.
        held_out: Expert to others, for temperature and threshold.
        sees_instruction: False blanks the instruction.
        layer: Which hidden states, -1 for the last.
        pooling: Of the patches.

    Raises:
        RoutingError: An expert without frames, or frames that do not tell anything apart.
    """
    reading = Reading(sees_instruction, layer, pooling)
    return fit(labelled(candidates, frames, reading), labelled(candidates, held_out, reading), reading)
