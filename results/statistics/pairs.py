"""Two sides on the same trials: difference, ratio and tests."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING

from robogauntlet.results.statistics.rates import CONFIDENCE, Estimate, Interval, wilson_intervals

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Pairs:
    """Outcomes of two sides on the same trials, counted."""

    both: int
    """Trials in which both succeeded."""
    first_only: int
    second_only: int
    neither: int

    @classmethod
    def from_outcomes(cls, first: NDArray[np.floating], second: NDArray[np.floating]) -> Pairs:
        """Count trials by two arrays of outcomes, 1 or 0, shape (trials,); those with a NaN on a side are left out."""
        import numpy as np

        valid = ~np.isnan(first) & ~np.isnan(second)
        one, other = first[valid] == 1, second[valid] == 1
        sides = (one & other, one & ~other, ~one & other, ~one & ~other)
        return cls(*(int(side.sum()) for side in sides))

    @property
    def trials(self) -> int:
        """Trials of each side."""
        return self.both + self.first_only + self.second_only + self.neither

    @property
    def first(self) -> int:
        """Successes of the first side."""
        return self.both + self.first_only

    @property
    def second(self) -> int:
        """Successes of the second side."""
        return self.both + self.second_only


MARGIN = 0.05
"""Default margin: a rate that is lower by less than this counts as no worse."""


def pooled(strata: Iterable[Pairs]) -> Pairs:
    """The pairs of all strata.

    McNemar's test of them is the conditional test stratified by them: a pair is compared with itself, so differences
    between strata cancel (D. G. Clayton and M. Hills, "Statistical Models in Epidemiology" (1993), chapter 19).
    """
    counts = [(pairs.both, pairs.first_only, pairs.second_only, pairs.neither) for pairs in strata]
    return Pairs(*map(sum, zip(*counts, strict=True))) if counts else Pairs(0, 0, 0, 0)


def mcnemar(pairs: Pairs) -> float:
    """Two-sided exact p-value against equal rates of two sides on the same trials.

    Under equal rates a pair that disagrees favours either side with probability 1/2: Q. McNemar, Psychometrika 12
    (1947) 153-157, with the binomial tail instead of chi-square. The number of pairs must be fixed in advance; if it is
    not, use `sequential.paired_evidence`.

    Returns:
        The p-value; 1 if no pair disagrees.
    """
    from scipy.stats import binomtest

    disagree = pairs.first_only + pairs.second_only
    return float(binomtest(pairs.first_only, disagree, 0.5).pvalue) if disagree else 1.0


def mcnemar_worse(pairs: Pairs) -> float:
    """One-sided exact p-value against the first side being as good as the second or better; see `mcnemar`."""
    from scipy.stats import binom

    return float(binom.sf(pairs.second_only - 1, pairs.first_only + pairs.second_only, 0.5))


def mcnemar_better(pairs: Pairs) -> float:
    """`mcnemar_worse` in the other direction."""
    return mcnemar_worse(Pairs(pairs.both, pairs.second_only, pairs.first_only, pairs.neither))


def can_reject(pairs: Pairs, alpha: float) -> bool:
    """Whether `mcnemar_worse` could reach alpha if all pairs that disagree were of one kind.

    Other tests may be left out of a family before its p-values are adjusted: the number of pairs that disagree is
    independent of the direction, which is tested (R. E. Tarone, Biometrics 46 (1990) 515-522).
    """
    disagree = pairs.first_only + pairs.second_only
    return disagree > 0 and disagree * math.log(0.5) <= math.log(alpha)


POWER = 0.8


def detectable_drop(pairs: Pairs, alpha: float) -> float | None:
    """The smallest drop of the rate that this number of pairs shows with `POWER`, at their share of disagreement.

    From R. J. Connor, "Sample size for testing differences in proportions for the paired-sample design", Biometrics 43
    (1987) 207-211: with psi the share of pairs that disagree, a one-sided test finds a drop d with this power in

        n = (z(1 - alpha) sqrt(psi) + z(power) sqrt(psi - d^2))^2 / d^2

    pairs; solved for d. A drop of d needs at least a share d of pairs that disagree, so psi is taken as no less.

    Returns:
        The drop, between 0 and 1, or None if even a drop from 1 to 0 would not be shown.
    """
    from scipy.optimize import brentq
    from scipy.stats import norm

    if not pairs.trials:
        return None
    share = (pairs.first_only + pairs.second_only) / pairs.trials
    z_alpha, z_power = norm.isf(alpha), norm.ppf(POWER)

    def lacking(drop: float) -> float:
        psi = max(share, drop)
        needed = (z_alpha * math.sqrt(psi) + z_power * math.sqrt(max(psi - drop**2, 0.0))) ** 2 / drop**2
        return float(needed - pairs.trials)

    return None if lacking(1.0) > 0 else float(brentq(lacking, 1e-9, 1.0))


def is_no_worse(pairs: Pairs, margin: float = MARGIN, confidence: float = CONFIDENCE) -> bool:
    """Whether the first side is shown to be worse than the second by less than a margin (non-inferiority).

    The lower end of `paired_difference` lies above -margin: an error of at most (1 - confidence) / 2. A test that does
    not reject equal rates does not show this.

    Raises:
        ValueError: A margin outside (0, 1), or a confidence outside (0, 1).
    """
    if not 0 < margin < 1:
        raise ValueError(f"expected a margin between 0 and 1, got {margin}")
    found = paired_difference(pairs, confidence)
    return found is not None and found.interval is not None and found.interval.low > -margin


def paired_difference(pairs: Pairs, confidence: float = CONFIDENCE) -> Estimate | None:
    """Rate of the first side minus rate of the second on the same trials, with a hybrid score interval.

    R. G. Newcombe, "Improved confidence intervals for the difference between binomial proportions based on paired
    data", Statistics in Medicine 17 (1998) 2635-2650, method 10: the Wilson intervals (l1, u1) and (l2, u2) of the two
    rates p1 and p2 are combined, with phi the correlation of the outcomes,

        p1 - p2 - sqrt((p1 - l1)² - 2 phi (p1 - l1)(u2 - p2) + (u2 - p2)²)
        p1 - p2 + sqrt((u1 - p1)² - 2 phi (u1 - p1)(p2 - l2) + (p2 - l2)²)

    where a positive phi is corrected for continuity. For several fixed tasks together it is conservative.

    Returns:
        Difference and interval, or None without trials.

    Raises:
        ValueError: The confidence is outside (0, 1).
    """
    n = pairs.trials
    one, two = wilson_intervals([pairs.first, pairs.second], [n, n], confidence)
    if one is None or two is None:
        return None
    p1, p2, phi = pairs.first / n, pairs.second / n, _phi(pairs)
    below = _combined(p1 - one.low, two.high - p2, phi)
    above = _combined(one.high - p1, p2 - two.low, phi)
    return Estimate(p1 - p2, Interval(max(p1 - p2 - below, -1.0), min(p1 - p2 + above, 1.0)))


def _phi(pairs: Pairs) -> float:
    """Correlation of the outcomes as Newcombe's method 10 takes it: 0 if one side always succeeds or always fails."""
    n = pairs.trials
    spread = pairs.first * (n - pairs.first) * pairs.second * (n - pairs.second)
    if spread == 0:
        return 0.0
    covariance = float(pairs.both * pairs.neither - pairs.first_only * pairs.second_only)
    return (max(covariance - n / 2, 0.0) if covariance > 0 else covariance) / math.sqrt(spread)


def _combined(a: float, b: float, phi: float) -> float:
    return math.sqrt(max(a * a - 2 * phi * a * b + b * b, 0.0))


def paired_ratio(pairs: Pairs) -> Estimate | None:
    """Successes of the first side per success of the second on the same trials, with a score interval (95 %).

    It has the ratios that a score test does not reject: N.-S. Tang, M.-L. Tang and I. S. F. Chan, "On tests of
    equivalence via non-unity relative risk for matched-pair design", Statistics in Medicine 22 (2003) 1217-1233. Equal
    rates are among them wherever `mcnemar`, which is exact, does not reject them at 5 %.

    Of several tasks it is the ratio of their sums, so that a task counts by its pairs. Where fixed tasks differ, the
    interval is conservative, like that of `paired_difference`.

    Returns:
        The ratio, or None if the second side never succeeds.
    """
    from scipy.optimize import brentq

    if not pairs.second:
        return None
    value, z = pairs.first / pairs.second, NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    share, least = pairs.first / (pairs.first + pairs.second), 1e-9

    def crossed(height: float, low: float, high: float) -> float:
        """The ratio, as share r / (1 + r) between two others, at which the score has this height."""
        found = float(brentq(lambda share: _ratio_score(pairs, share / (1 - share)) - height, low, high))
        return found / (1 - found)

    low = crossed(z, least, share) if pairs.first else 0.0
    high = crossed(-z, share or least, 1 - least)
    if mcnemar(pairs) > 1 - CONFIDENCE:
        low, high = min(low, 1.0), max(high, 1.0)
    return Estimate(value, Interval(low, high))


def _ratio_score(pairs: Pairs, ratio: float) -> float:
    """Standard normal score against rates with this ratio, positive where the first side is better than that."""
    excess = pairs.first - ratio * pairs.second
    if not excess:
        return 0.0
    some = pairs.trials - pairs.neither
    linear = ratio**2 * pairs.second - pairs.first - 2 * pairs.second_only
    root = math.sqrt(max(linear**2 - 4 * (1 - ratio**2) * pairs.second_only * some, 0.0))
    # The most likely number of trials in which only the second succeeds, if the rates have this ratio.
    second_only = (root - linear) / (2 * (1 + ratio))
    variance = (1 + ratio) * second_only + (ratio - 1) * some
    return excess / math.sqrt(variance) if variance > 0 else math.copysign(math.inf, excess)
