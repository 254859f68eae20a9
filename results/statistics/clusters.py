"""Failure clusters: one or two conditions `axis >= threshold` under which a policy fails more often than elsewhere.

Clusters are looked for at one half of the seeds and tested at the other, so that chance that made a candidate stand out
does not also confirm it (D. R. Cox, "A note on data-splitting for the evaluation of significance levels", Biometrika 62
(1975) 441-444).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.statistics.multiplicity import ALPHA, holm
from robogauntlet.results.statistics.rates import Estimate, clustered_rate

HIGHEST = 5.0
LEAST_EPISODES = 10
LEAST_SHARE = 0.02
"""A candidate has at least `LEAST_EPISODES` and this share of the episodes that discover, and leaves out as many."""
LEAST_SCORE = 1.645
"""Candidates that score less in discovery are not tested: the one-sided 5 % point of a normal distribution."""
MOST = 10
"""Candidates that are tested."""
MOST_AXES = 100
"""Axes up to which pairs are candidates."""
OVERLAP = 0.8
"""Of two candidates, the lower-scored is dropped if they share this part of the episodes that either has."""
DRAWS = 9999
"""Permutations per test."""

Mask = NDArray[np.bool_]
Places = tuple[tuple[int, int], ...]
"""Conditions as columns and thresholds."""


@dataclass(frozen=True, slots=True, order=True)
class AxisCondition:
    """Severities from a threshold on."""

    axis: str
    threshold: int
    """A whole severity, 1 to 5."""


@dataclass(frozen=True, slots=True)
class Support:
    """Episodes that satisfy all conditions, in one half."""

    episodes: int
    failures: int


@dataclass(frozen=True, slots=True)
class Cluster:
    """Conditions under which failure is shown to be more frequent. Rates are of the half that confirms."""

    conditions: tuple[AxisCondition, ...]
    """One, or two on different axes, in the order of the axes."""
    discovery: Support
    confirmation: Support
    within: Estimate
    """Failure rate where all conditions hold."""
    outside: Estimate
    """Failure rate where one does not."""
    lift: float
    """`within` / `outside`; infinite if nothing fails outside."""
    p_value: float
    """Adjusted by Holm over all candidates that were tested."""


@dataclass(frozen=True, slots=True)
class _Half:
    """Episodes that discover, or those that confirm."""

    severities: NDArray[np.float64]
    """Shape (episodes, axes)."""
    failed: NDArray[np.float64]
    """Shape (episodes,)."""
    unit: NDArray[np.intp]
    """Number of the episode's group and seed."""
    point: NDArray[np.intp]
    """Number of the episode's point: episodes of one point have the same group and severities."""
    stratum: NDArray[np.intp]
    """Of each point: points of one stratum are played at the same seeds."""

    @classmethod
    def of(
        cls, severities: NDArray[np.float64], failed: Mask, seeds: NDArray[np.int64], groups: NDArray[np.int64]
    ) -> _Half:
        """Points of different groups are not exchanged, as their seeds count as different."""
        unit = np.unique(np.column_stack([groups, seeds]), axis=0, return_inverse=True)[1].reshape(-1)
        _, point = np.unique(np.column_stack([severities, groups]), axis=0, return_inverse=True)
        point = np.asarray(point).reshape(-1)
        order = np.lexsort((unit, point))
        played_at = np.split(unit[order], np.flatnonzero(np.diff(point[order])) + 1)
        known: dict[bytes, int] = {}
        stratum = [known.setdefault(np.ascontiguousarray(units).tobytes(), len(known)) for units in played_at]
        return cls(severities, failed.astype(float), unit, point, np.array(stratum, dtype=np.intp))

    def mask(self, places: Places) -> Mask:
        """Episodes that satisfy all conditions, each a column and a threshold."""
        found = np.ones(len(self.failed), dtype=bool)
        for column, threshold in places:
            found &= self.severities[:, column] >= threshold
        return found

    def support(self, mask: Mask) -> Support:
        return Support(int(mask.sum()), int(self.failed[mask].sum()))


def failure_clusters(
    severities: NDArray[np.floating],
    failed: NDArray[np.bool_],
    seeds: NDArray[np.integer],
    axes: Sequence[str],
    generator: np.random.Generator,
    *,
    groups: NDArray[np.integer] | None = None,
    alpha: float = ALPHA,
) -> tuple[Cluster, ...]:
    """Clusters of failures, confirmed in episodes that were not used to find them.

    The seeds, sorted, take turns: the first, third, ... discover, the others confirm. Points, which are all episodes of
    the same severities, are divided too: those played at seeds of both halves are assigned to a half at random, and
    their episodes at seeds of the other are left out. Otherwise points that fail for other reasons would favour the
    same candidates in both halves. A design with other points at every seed loses no episode.

    In discovery, a candidate's score is the signed root of the log likelihood ratio of two failure rates against one
    (M. Kulldorff, "A spatial scan statistic", Commun. Statist. Theory Meth. 26 (1997) 1481-1496): of its episodes
    against all others, and for a pair also against those that satisfy only one of its conditions, the least of the
    three. Each axis and each pair of axes has one candidate, at the thresholds that score highest. Those that nearly
    coincide with a better one are dropped, and the best `MOST` are tested. Pairs of more than `MOST_AXES` axes are left
    out.

    A candidate is a cluster if it fails more often than all others do, and a pair also more often than the episodes
    that satisfy only its first condition, and only its second: the largest p-value counts (an intersection-union test:
    R. L. Berger, Technometrics 24 (1982) 295-300), adjusted by Holm over the candidates. A single condition is left out
    if its excess is that of pairs that contain it: no excess is shown in the remaining episodes.

    Each p-value is of a permutation of whole points, among points that are played at the same seeds, so that it stays
    valid if episodes of a seed or of a point are alike; a test of single episodes would not. Where one condition holds
    throughout, points are exchanged only at the same whole severity of its axis, as failures that grow along that axis
    are no evidence for the other. There are `DRAWS` permutations, and the actual one counts as one more (B. Phipson and
    G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 9 (2010) 39). With few points, such as a small grid of whole severities
    at many seeds, hardly any pair can be shown.

    Args:
        severities: Shape (episodes, axes), from 0 to 5.
        failed: Shape (episodes,), without errors.
        seeds: Shape (episodes,).
        axes: Names of the columns.
        generator: The same state gives the same clusters, whatever the order of the episodes.
        groups: Number of each episode's group, such as its task, shape (episodes,). Points are exchanged within groups.
        alpha: Probability of any false cluster, at most.

    Returns:
        Clusters, highest lift first; none with a single seed.

    Raises:
        ValueError: Shapes that do not fit, severities outside 0 to 5, outcomes other than true and false, seeds that
            are no integers, names that repeat, or an alpha outside (0, 1).
    """
    levels, fails, numbers = _checked(severities, failed, seeds, axes, alpha)
    halves = _halves(levels, numbers, generator)
    if not all(half.any() for half in halves):
        return ()
    group = np.zeros(len(fails), dtype=np.int64) if groups is None else np.asarray(groups, dtype=np.int64)
    one, other = (_Half.of(levels[half], fails[half], numbers[half], group[half]) for half in halves)
    listed = _short_list(one)
    p_values = holm([_p_value(other, places, generator) for places in listed])
    confirmed = {places: p for places, p in zip(listed, p_values, strict=True) if p <= alpha}
    pairs = [places for places in confirmed if len(places) > 1]
    found = [
        _cluster(one, other, places, axes, p)
        for places, p in confirmed.items()
        if len(places) > 1 or not _is_explained(other, places[0], pairs, alpha, generator)
    ]
    return tuple(sorted(found, key=lambda cluster: (-cluster.lift, cluster.p_value, cluster.conditions)))


def _halves(
    severities: NDArray[np.float64], seeds: NDArray[np.int64], generator: np.random.Generator
) -> tuple[Mask, Mask]:
    """Episodes that discover and those that confirm, with no seed and no point in both; some are in neither."""
    first = np.unique(seeds, return_inverse=True)[1].reshape(-1) % 2 == 0
    point = np.unique(severities, axis=0, return_inverse=True)[1].reshape(-1)
    played = [np.bincount(point[half], minlength=point.max() + 1) > 0 for half in (first, ~first)]
    shared = generator.permutation(np.flatnonzero(played[0] & played[1]))
    discovers, confirms = (np.ones(len(played[0]), dtype=bool) for _ in range(2))
    discovers[shared[len(shared) // 2 :]] = False
    confirms[shared[: len(shared) // 2]] = False
    return first & discovers[point], ~first & confirms[point]


def _is_explained(
    half: _Half, place: tuple[int, int], pairs: Sequence[Places], alpha: float, generator: np.random.Generator
) -> bool:
    """Whether no excess of failures is shown under a condition once the episodes of pairs with it are left out."""
    containing = [half.mask(pair) for pair in pairs if place[0] in dict(pair)]
    if not containing:
        return False
    left = ~np.logical_or.reduce(containing)
    alone = half.mask((place,))
    return _permutation(half, alone & left, ~alone & left, None, generator) > alpha


def _short_list(half: _Half) -> list[Places]:
    """Candidates worth testing, best first."""
    scored: list[tuple[float, Places]] = []
    least = _least(half)
    counts = (half.severities >= 1).sum(axis=0)
    # A pair has no more episodes than either of its conditions, so rare axes are in none.
    columns = [column for column, count in enumerate(counts) if count >= least]
    sizes = (1, 2) if half.severities.shape[1] <= MOST_AXES else (1,)
    for chosen in chain.from_iterable(combinations(columns, size) for size in sizes):
        scores = _scores(half, chosen)
        best = np.unravel_index(int(np.argmax(scores)), scores.shape)
        if scores[best] >= LEAST_SCORE:
            places = tuple((column, 1 + int(step)) for column, step in zip(chosen, best, strict=True))
            scored.append((float(scores[best]), places))
    kept: list[Places] = []
    for _, places in sorted(scored, key=lambda item: (-item[0], len(item[1]), item[1])):
        if not any(_overlap(half.mask(places), half.mask(better)) >= OVERLAP for better in kept):
            kept.append(places)
    return kept[:MOST]


def _least(half: _Half) -> float:
    """Fewest episodes of a candidate."""
    return max(LEAST_EPISODES, LEAST_SHARE * len(half.failed))


def _scores(half: _Half, chosen: tuple[int, ...]) -> NDArray[np.float64]:
    """Scores of all thresholds on one or two columns, shape (5,) or (5, 5); -inf where the support is too small."""
    counts, failures = (_exceeding(half, chosen, weights) for weights in (np.ones(len(half.failed)), half.failed))
    inner, every = slice(1, None), slice(0, 1)
    within = (inner,) * len(chosen)
    parents = [(every,) * len(chosen)]
    if len(chosen) > 1:
        parents += [(inner, every), (every, inner)]
    roots = [
        _signed_root(
            counts[within], failures[within], counts[whole] - counts[within], failures[whole] - failures[within]
        )
        for whole in parents
    ]
    total = len(half.failed)
    least = _least(half)
    supported = (counts[within] >= least) & (counts[within] <= total - least)
    return np.where(supported, np.min(roots, axis=0), -np.inf)


def _exceeding(half: _Half, chosen: tuple[int, ...], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of weights of episodes with severities from each whole one on, shape (6,) or (6, 6), for columns chosen."""
    size = (int(HIGHEST) + 1,) * len(chosen)
    place = np.ravel_multi_index([half.severities[:, column].astype(int) for column in chosen], size)
    found = np.asarray(np.bincount(place, weights, math.prod(size)), dtype=float).reshape(size)
    for axis in range(len(chosen)):
        found = np.flip(np.cumsum(np.flip(found, axis), axis), axis)
    return found


def _comparisons(half: _Half, places: Places) -> Iterator[tuple[Mask, int | None]]:
    """What a candidate is compared with: episodes, and the column of the condition that they satisfy, if any."""
    mask = half.mask(places)
    yield ~mask, None
    if len(places) > 1:
        for place in places:
            yield half.mask((place,)) & ~mask, place[0]


def _signed_root(
    trials: NDArray[np.float64],
    failures: NDArray[np.float64],
    rest_trials: NDArray[np.float64],
    rest_failures: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Signed roots of the log likelihood ratio of two rates against one, positive if more fail within than in the rest.

    -inf if nothing remains to compare with.
    """
    separate = _log_likelihood(failures, trials) + _log_likelihood(rest_failures, rest_trials)
    gain = separate - _log_likelihood(failures + rest_failures, trials + rest_trials)
    more = failures * rest_trials > rest_failures * trials
    root = np.sqrt(np.maximum(2 * gain, 0))
    return np.where((trials > 0) & (rest_trials > 0), np.where(more, root, -root), -np.inf)


def _log_likelihood(failures: NDArray[np.float64], trials: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.special import xlogy

    rate = failures / np.maximum(trials, 1)
    found: NDArray[np.float64] = xlogy(failures, rate) + xlogy(trials - failures, 1 - rate)
    return found


def _overlap(one: Mask, other: Mask) -> float:
    """Share of the episodes of either that are of both."""
    return float((one & other).sum() / (one | other).sum())


def _p_value(half: _Half, places: Places, generator: np.random.Generator) -> float:
    """Largest p-value of a candidate's comparisons."""
    within = half.mask(places)
    return max(_permutation(half, within, rest, column, generator) for rest, column in _comparisons(half, places))


def _permutation(half: _Half, within: Mask, rest: Mask, column: int | None, generator: np.random.Generator) -> float:
    """One-sided p-value against points within failing no more often than those of the rest."""
    points = len(half.stratum)
    sums = np.bincount(half.point, half.failed, points)
    side = np.full(points, -1)
    side[half.point[rest]], side[half.point[within]] = 0, 1
    stratum = half.stratum
    if column is not None:
        severity = np.zeros(points, dtype=np.intp)
        severity[half.point] = half.severities[:, column]
        stratum = stratum * (int(HIGHEST) + 1) + severity
    seen, drawn = 0.0, np.zeros(DRAWS)
    for number in np.unique(stratum[side >= 0]):
        own = (stratum == number) & (side >= 0)
        values, counts = np.unique(sums[own], return_counts=True)
        chosen = int(side[own].sum())
        seen += float(sums[own][side[own] == 1].sum())
        if len(values) > 1:
            drawn += generator.multivariate_hypergeometric(counts, chosen, DRAWS, method="marginals") @ values
        else:
            drawn += chosen * values[0]
    return float((1 + (drawn >= seen - 1e-9).sum()) / (1 + DRAWS))


def _cluster(one: _Half, other: _Half, places: Places, axes: Sequence[str], p_value: float) -> Cluster:
    mask = other.mask(places)
    within, outside = (
        clustered_rate(other.failed[side], other.point[side], other.unit[side]) for side in (mask, ~mask)
    )
    return Cluster(
        conditions=tuple(AxisCondition(axes[column], threshold) for column, threshold in places),
        discovery=one.support(one.mask(places)),
        confirmation=other.support(mask),
        within=within,
        outside=outside,
        lift=within.value / outside.value if outside.value else math.inf,
        p_value=p_value,
    )


def _checked(
    severities: NDArray[np.floating],
    failed: NDArray[np.bool_],
    seeds: NDArray[np.integer],
    axes: Sequence[str],
    alpha: float,
) -> tuple[NDArray[np.float64], Mask, NDArray[np.int64]]:
    levels, fails, numbers = np.asarray(severities, dtype=float), np.asarray(failed), np.asarray(seeds)
    if levels.ndim != 2 or levels.shape[1] != len(axes) or not axes:
        raise ValueError(f"expected severities of shape (episodes, {len(axes)}), got {levels.shape}")
    if fails.shape != levels.shape[:1] or numbers.shape != levels.shape[:1]:
        raise ValueError(f"expected {len(levels)} outcomes and seeds, got shapes {fails.shape} and {numbers.shape}")
    if not len(levels):
        raise ValueError("expected at least one episode, got none")
    if not np.all((levels >= 0) & (levels <= HIGHEST)):
        raise ValueError("expected severities from 0 to 5 and none missing")
    if fails.dtype != bool:
        raise ValueError(f"expected outcomes that are true or false, got {fails.dtype}")
    if not np.issubdtype(numbers.dtype, np.integer):
        raise ValueError(f"expected seeds that are integers, got {numbers.dtype}")
    if len(set(axes)) < len(axes):
        raise ValueError(f"expected names of axes that differ, got {list(axes)}")
    if not 0 < alpha < 1:
        raise ValueError(f"expected an alpha between 0 and 1, got {alpha}")
    return levels, fails, numbers.astype(np.int64)
