"""The best of several, chosen on one half of the trials and measured on the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from robogauntlet.results.statistics.rates import Estimate, wilson_interval

Count = tuple[int, int]
"""Successes and trials."""


@dataclass(frozen=True, slots=True)
class HeldOutBest:
    """The candidate with the highest rate on one half, and its rate on the other."""

    index: int
    """Its place among the candidates."""
    chosen_on: Count
    """Its counts on the half on which it was chosen; their rate is too high on average."""
    measured_on: Count
    """Its counts on the other half."""
    estimate: Estimate
    """The rate of `measured_on` with Wilson's interval."""


def held_out_best(choosing: Sequence[Count], measuring: Sequence[Count]) -> HeldOutBest | None:
    """Choose the candidate with the highest rate on one half of the trials, and estimate its rate from the other half.

    The highest of several estimated rates overstates its own true rate (the winner's curse). The choice uses nothing of
    the second half, so that the rate there is unbiased and its interval covers as that of a candidate which was named
    in advance: D. R. Cox, "A note on data-splitting for the evaluation of significance levels", Biometrika 62 (1975)
    441-444. The trials of the two halves have to be independent.

    Args:
        choosing: The counts of each candidate on the first half; of equal rates the first candidate is chosen.
        measuring: Those on the second half, in the same order.

    Returns:
        The best; None if no candidate has trials on both halves.

    Raises:
        ValueError: Another number of counts on the second half than on the first.
    """
    if len(choosing) != len(measuring):
        raise ValueError(f"expected counts of {len(choosing)} candidates on both halves, got {len(measuring)}")
    usable = [place for place, both in enumerate(zip(choosing, measuring, strict=True)) if all(n for _, n in both)]
    if not usable:
        return None
    best = max(usable, key=lambda place: choosing[place][0] / choosing[place][1])
    successes, trials = measuring[best]
    estimate = Estimate(successes / trials, wilson_interval(successes, trials))
    return HeldOutBest(best, choosing[best], measuring[best], estimate)
