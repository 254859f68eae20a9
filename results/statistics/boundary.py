"""The severity at which success falls below a share of its clean rate, estimated from few episodes."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from robogauntlet.results.statistics.rates import CONFIDENCE, rate_difference

STEP = 0.1
"""Distance of the boundaries between which the estimate decides."""
EXPONENTS = (1.5, 2.5, 4.0, 7.0, 12.0, 25.0)
"""How steeply success may fall about the boundary."""
CLEAN_RATES = 12
"""Clean rates over which the estimate takes the mean, equally likely by the clean episodes."""
NEVER = 0.25
"""Prior probability that the boundary lies beyond the largest severity."""
POWER = 0.9
"""Probability, by the estimate, with which a disturbance that is proposed for confirmation is confirmed.

Fewer are, as what the search found smallest is too small on average (the winner's curse), and hardly any where success
levels off just below the share of the clean rate: `studies/worst_cases`."""
INSIDE = 0.8
"""Probability of the interval of a boundary."""


@dataclass(frozen=True, slots=True)
class Trials:
    """Episodes with a verdict."""

    successes: int = 0
    trials: int = 0

    def __add__(self, other: Trials) -> Trials:
        return Trials(self.successes + other.successes, self.trials + other.trials)


@dataclass(frozen=True, slots=True)
class Boundary:
    """Where success falls below the share of the clean rate. None stands for beyond the largest severity."""

    value: float | None
    """The median of the posterior."""
    low: float | None
    high: float | None
    """Ends of the interval that has it with a probability of `INSIDE`."""


class BoundaryEstimate:
    """The boundary along one direction, as a posterior on a grid.

    Success at the severity t is modelled as c / (1 + (1 / f - 1) (t / m)^k), a logistic function of log t that is the
    clean rate c at 0 and f c at the boundary m. Severities are played at quantiles of the posterior of m, as in QUEST
    (A. B. Watson and D. G. Pelli, "QUEST: a Bayesian adaptive psychometric method", Perception & Psychophysics 33
    (1983) 113-120); slope and upper asymptote are unknown too, as in the psi method (L. L. Kontsevich and C. W. Tyler,
    "Bayesian adaptive estimation of psychometric slope and threshold", Vision Research 39 (1999) 2729-2737). A priori m
    is uniform up to the largest severity and beyond it with the probability `NEVER`; k is any of `EXPONENTS`; c has
    the posterior of the clean episodes under Jeffreys' prior.
    """

    def __init__(self, largest: float, *, below: float = 0.5, whole: bool = False) -> None:
        """Know nothing yet.

        Args:
            largest: The largest severity that can be played.
            below: The share f of the clean rate.
            whole: Whether only whole severities can be played.
        """
        inside = np.arange(STEP / 2, largest, STEP)
        beyond = largest * np.linspace(1.02, 2.0, 12)
        self._boundaries: NDArray[np.float64] = np.concatenate([inside, beyond])
        share_inside, share_beyond = (1 - NEVER) / len(inside), NEVER / len(beyond)
        self._prior = np.where(self._boundaries < largest, share_inside, share_beyond)
        self._largest, self._below, self._whole = largest, below, whole
        self._told: dict[float, Trials] = {}
        self._clean = Trials()

    @property
    def trials(self) -> int:
        """Episodes with a verdict, clean ones not counted."""
        return sum(one.trials for one in self._told.values())

    def tell(self, severity: float, found: Trials) -> None:
        """Learn the outcome of episodes at a severity above 0."""
        self._told[severity] = self._told.get(severity, Trials()) + found
        self._forget()

    def tell_clean(self, found: Trials) -> None:
        """Learn the outcome of clean episodes, all of them: they replace those that were told before."""
        self._clean = found
        self._forget()

    def ask(self, points: int = 1) -> list[float]:
        """Return the severities to play next, rounded to what can be played: quantiles of the posterior, each once."""
        quantiles = (np.arange(points) + 0.5) / points
        return sorted({self._playable(value) for value in self._quantiles(quantiles)})

    def boundary(self) -> Boundary:
        """Return what is known of the boundary."""
        ends = self._quantiles([0.5, (1 - INSIDE) / 2, (1 + INSIDE) / 2])
        return Boundary(*(float(value) if value <= self._largest else None for value in ends))

    @property
    def median(self) -> float:
        """The median of the posterior, also beyond the largest severity."""
        return float(self._quantiles([0.5])[0])

    def to_confirm(self, trials: int) -> float | None:
        """Return the smallest severity that is expected to be confirmed, with a probability of `POWER`.

        Confirmation is by `is_below` after as many clean as perturbed episodes. The value is rounded upwards to what
        can be played, in steps of `STEP`; None if no severity is that bad.
        """
        if not trials:
            return None
        clean = self._clean_rates.mean()
        expected = Trials(round(clean * trials), trials)
        most = max((k for k in range(trials + 1) if is_below(Trials(k, trials), expected, self._below)), default=None)
        if most is None:
            return None
        candidates = self._candidates()
        first = bisect_left(candidates, POWER, key=partial(self._confirmed, most, trials))
        return candidates[first] if first < len(candidates) else None

    def _confirmed(self, most: int, trials: int, severity: float) -> float:
        """Probability of at most `most` successes at a severity, with which it grows."""
        return float((special.bdtr(most, trials, self._success(severity)) * self._posterior).sum())

    def _candidates(self) -> list[float]:
        if self._whole:
            return [float(n) for n in range(1, int(self._largest) + 1)]
        return [*(round(STEP * n, 2) for n in range(1, int(self._largest / STEP) + 1)), self._largest]

    def _playable(self, severity: float) -> float:
        least = 1.0 if self._whole else STEP
        return float(min(max(round(severity, 0 if self._whole else 2), least), self._largest))

    def _forget(self) -> None:
        for name in ("_posterior", "_clean_rates"):
            self.__dict__.pop(name, None)

    @cached_property
    def _clean_rates(self) -> NDArray[np.float64]:
        """Equally likely clean rates, shape (1, 1, CLEAN_RATES)."""
        won, lost = self._clean.successes + 0.5, self._clean.trials - self._clean.successes + 0.5
        found: NDArray[np.float64] = stats.beta.ppf((np.arange(CLEAN_RATES) + 0.5) / CLEAN_RATES, won, lost)
        return found.reshape(1, 1, -1)

    def _success(self, severity: float) -> NDArray[np.float64]:
        """Probability of success at a severity, by boundary, exponent and clean rate."""
        ratio = (severity / self._boundaries)[:, None, None]
        powers = ratio ** np.asarray(EXPONENTS)[None, :, None]
        found: NDArray[np.float64] = self._clean_rates / (1 + (1 / self._below - 1) * powers)
        return np.clip(found, 1e-3, 1 - 1e-3)

    @cached_property
    def _posterior(self) -> NDArray[np.float64]:
        """Probability by boundary, exponent and clean rate."""
        shape = (len(self._boundaries), len(EXPONENTS), CLEAN_RATES)
        log = np.broadcast_to(np.log(self._prior)[:, None, None], shape).copy()
        for severity, found in self._told.items():
            success = self._success(severity)
            log += found.successes * np.log(success) + (found.trials - found.successes) * np.log1p(-success)
        likely: NDArray[np.float64] = np.exp(log - log.max())
        return likely / likely.sum()

    def _quantiles(self, quantiles: NDArray[np.float64] | list[float]) -> NDArray[np.float64]:
        total = self._posterior.sum(axis=(1, 2)).cumsum()
        found: NDArray[np.float64] = np.interp(quantiles, total, self._boundaries + STEP / 2)
        return found


def is_below(perturbed: Trials, clean: Trials, share: float) -> bool:
    """Whether success is shown to be below a share of the clean rate: the interval of `excess` lies below 0."""
    return excess(perturbed, clean, share)[1] < 0


def excess(perturbed: Trials, clean: Trials, share: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """The ends of `rate_difference` of success and a share of clean success; -1 and 1 without trials of either.

    Both rates on the same seeds are correlated upwards as a rule, which makes the interval wider than necessary.
    """
    sides = (perturbed.successes, perturbed.trials), (clean.successes, clean.trials)
    found = rate_difference(*sides, share, confidence)
    ends = found.interval if found else None
    return (ends.low, ends.high) if ends else (-1.0, 1.0)
