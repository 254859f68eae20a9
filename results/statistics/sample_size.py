"""How many trials an interval or a paired test needs."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.statistics.pairs import POWER
from robogauntlet.results.statistics.rates import CONFIDENCE

MOST_EXACT = 100_000
"""Pairs up to which the power of McNemar's test is summed exactly; beyond, the normal approximation is off by less than
a thousandth of them."""
MOST_CHECKED = 1_000
"""Pairs up to which it is checked that a few more do not lack the power again."""


def shrunk_share(successes: int, trials: int, confidence: float = CONFIDENCE) -> float:
    """The centre of the Wilson interval of a share: what to assume of it for more trials.

    (k + z²/2) / (n + z²), between the observed share and 1/2: never 0 or 1, however one-sided few trials are (A.
    Agresti and B. A. Coull, The American Statistician 52 (1998) 119-126).

    Raises:
        ValueError: The counts are not 0 <= successes <= trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"expected 0 <= successes <= trials, got {successes} of {trials}")
    squared = _z(confidence) ** 2
    return (successes + squared / 2) / (trials + squared)


def half_width(rate: float, trials: int, confidence: float = CONFIDENCE) -> float:
    """Half of the distance between the ends of the Wilson interval of a rate, see `rates.wilson_interval`.

    Args:
        rate: Observed rate, from 0 to 1; rate x trials need not be whole.
        trials: At least 1.
        confidence: Probability with which the interval covers the true rate.

    Returns:
        A share between 0 and 1/2.
    """
    squared = _z(confidence) ** 2
    return math.sqrt(squared * (rate * (1 - rate) * trials + squared / 4)) / (trials + squared)


def trials_for_half_width(rate: float, target: float, confidence: float = CONFIDENCE) -> int:
    """The smallest number of trials whose `half_width` at a rate is at most `target` (a share above 0).

    The half-width decreases with the trials, so it is solved for them: with a = z²/target², the larger root n of
    n² + (2 z² - a rate (1 - rate)) n + z⁴ - a z²/4 = 0, rounded up.

    Raises:
        ValueError: A rate outside [0, 1] or a target outside (0, 1).
    """
    if not 0 <= rate <= 1 or not 0 < target < 1:
        raise ValueError(f"expected a rate in [0, 1] and a half-width in (0, 1), got {rate} and {target}")
    squared = _z(confidence) ** 2
    ratio = squared / target**2
    linear, constant = 2 * squared - ratio * rate * (1 - rate), squared**2 - ratio * squared / 4
    inside = linear**2 - 4 * constant
    root = (-linear + math.sqrt(inside)) / 2 if inside > 0 else 0.0
    trials = max(math.ceil(root) - 1, 1)  # Rounding may put the root just above a whole number.
    while half_width(rate, trials, confidence) > target:
        trials += 1
    return trials


def independent_discordance(difference: float) -> float:
    """The share of pairs that disagree between two sides with independent outcomes and rates around 1/2.

    With rates p + d/2 and p - d/2 it is 2 p (1 - p) + d²/2, at most (1 + d²) / 2. Sides whose outcomes on the same
    trial are alike more often than by chance disagree less.
    """
    return (1 + difference**2) / 2


def mcnemar_power(pairs: int, discordance: float, difference: float, alpha: float = ALPHA) -> float:
    """The probability that `pairs.mcnemar` is at most alpha, in favour of the side that is better.

    The number m of pairs that disagree is binomial (pairs, discordance), and of these the better side wins a binomial
    number (m, (1 + difference / discordance) / 2): S. W. Duffy, "Asymptotic and exact power for the McNemar test and
    its analogue with R controls per case", Biometrics 40 (1984) 1005-1015. Beyond `MOST_EXACT` pairs R. J. Connor's
    normal approximation, see `pairs.detectable_drop`, with a continuity correction of one pair.

    Args:
        pairs: At least 1.
        discordance: Share of pairs that disagree.
        difference: True difference of the two rates, above 0.
        alpha: Largest p-value that counts, two-sided.

    Raises:
        ValueError: A difference that is not above 0 and at most the discordance, or a discordance above 1.
    """
    from scipy.stats import binom

    _check(discordance, difference)
    if pairs > MOST_EXACT:
        return _approximate_power(pairs, discordance, difference, alpha)
    centre, spread = pairs * discordance, 10 * math.sqrt(pairs * discordance * (1 - discordance)) + 10
    disagree = np.arange(max(math.floor(centre - spread), 0), min(math.ceil(centre + spread), pairs) + 1)
    fewest = binom.ppf(alpha / 2, disagree, 0.5)  # most wins of the worse side with which the test rejects
    fewest -= binom.cdf(fewest, disagree, 0.5) > alpha / 2
    rejected = binom.cdf(fewest, disagree, (1 - difference / discordance) / 2)
    return float(np.sum(binom.pmf(disagree, pairs, discordance) * np.where(fewest < 0, 0.0, rejected)))


def pairs_for_power(
    discordance: float, difference: float, alpha: float = ALPHA, *, power: float = POWER, step: int = 1
) -> int:
    """The smallest number of pairs, a multiple of `step`, with which `mcnemar_power` reaches `power`.

    The power of an exact test is not monotone: up to `MOST_CHECKED` pairs, the number is one after which a fifth more
    do not lack the power again.

    Raises:
        ValueError: See `mcnemar_power`.
    """
    _check(discordance, difference)

    def suffices(steps: int) -> bool:
        return mcnemar_power(steps * step, discordance, difference, alpha) >= power

    below, enough = 0, 1
    while not suffices(enough):
        below, enough = enough, 2 * enough
    while enough - below > 1:
        middle = (below + enough) // 2
        below, enough = (below, middle) if suffices(middle) else (middle, enough)
    if enough * step <= MOST_CHECKED:
        lacking = [more for more in range(enough, enough + enough // 5 + 2) if not suffices(more)]
        enough = lacking[-1] + 1 if lacking else enough
    return enough * step


def detectable_difference(
    pairs: int, discordance: float, alpha: float = ALPHA, *, power: float = POWER
) -> float | None:
    """The smallest true difference that `pairs.mcnemar` shows in this many pairs with a power, exactly.

    `pairs.detectable_drop` approximates it. A difference d needs at least a share d of pairs that disagree, so the
    discordance is taken as no less.

    Returns:
        A share between 0 and 1, to four digits, or None if even a difference of 1 would not be shown.
    """
    below, enough = 0, 10_000
    if mcnemar_power(pairs, 1.0, 1.0, alpha) < power:
        return None
    while enough - below > 1:
        middle = (below + enough) // 2
        difference = middle / 10_000
        reached = mcnemar_power(pairs, max(discordance, difference), difference, alpha) >= power
        below, enough = (below, middle) if reached else (middle, enough)
    return enough / 10_000


def separate_difference(rate: float, trials: int, alpha: float = ALPHA, *, power: float = POWER) -> float | None:
    """The smallest true drop from a rate that a test of two separate groups of this many trials shows with a power.

    J. L. Fleiss, "Statistical Methods for Rates and Proportions" (1981), chapter 3, without correction for continuity:
    n = (z(alpha / 2) sqrt(2 m (1 - m)) + z(power) sqrt(p (1 - p) + q (1 - q)))² / (p - q)², with m the mean of p and q.

    Returns:
        A share above 0, or None if even a drop to 0 would not be shown.

    Raises:
        ValueError: A rate outside (0, 1], or no trials.
    """
    from scipy.optimize import brentq

    if not 0 < rate <= 1 or trials < 1:
        raise ValueError(f"expected a rate in (0, 1] and a trial or more, got {rate} and {trials}")
    z_alpha, z_power = _z(1 - alpha), NormalDist().inv_cdf(power)

    def lacking(drop: float) -> float:
        lower, middle = rate - drop, rate - drop / 2
        spread = rate * (1 - rate) + lower * (1 - lower)
        return (z_alpha * math.sqrt(2 * middle * (1 - middle)) + z_power * math.sqrt(spread)) ** 2 - trials * drop**2

    return None if lacking(rate) > 0 else float(brentq(lacking, 1e-9, rate))


def _z(confidence: float) -> float:
    return NormalDist().inv_cdf((1 + confidence) / 2)


def _check(discordance: float, difference: float) -> None:
    if not 0 < difference <= discordance <= 1:
        raise ValueError(
            f"expected 0 < difference <= discordance <= 1, got a difference of {difference} and a discordance of "
            f"{discordance}"
        )


def _approximate_power(pairs: int, discordance: float, difference: float, alpha: float) -> float:
    normal = NormalDist()
    excess = (difference * pairs - 1) / math.sqrt(pairs) + normal.inv_cdf(alpha / 2) * math.sqrt(discordance)
    spread = math.sqrt(discordance - difference**2)
    return normal.cdf(excess / spread) if spread > 0 else float(excess > 0)
