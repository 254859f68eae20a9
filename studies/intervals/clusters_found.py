"""How often failure clusters are found that are there, and reported that are not, by 500 simulated experiments each.

Severities are uniform from 0 to 5; 800 episodes per experiment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from robogauntlet.results.statistics.clusters import Cluster, failure_clusters
from studies.percent import few
from studies.shared import table_of

EXPERIMENTS = few(500)
DESIGNS = {"200 points at 4 seeds each": (200, 4), "100 points at 8 seeds each": (100, 8), "800 points": (800, 1)}
"""Points, and seeds at which each is played; with one, the points take turns over `TURNS` seeds."""
TURNS = 4
SEED = 20261126
NODES = 40
"""Nodes of the integral over effects of seeds."""
LEAST = 3
"""Threshold of both planted conditions."""
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Policy:
    """A policy whose clusters are known."""

    axes: int
    rate: Callable[[Array], Array]
    """Severities, shape (points, axes), to failure rates."""
    planted: frozenset[str]
    """Axes of its only cluster; empty if it has none."""
    seed_spread: float = 0.0
    """Standard deviation of the effects of seeds on the logit of the rate."""
    point_spread: float = 0.0
    """The same of effects of points that no axis explains."""

    def episodes(
        self, points: int, seeds: int, generator: np.random.Generator
    ) -> tuple[Array, NDArray[np.bool_], NDArray[np.integer]]:
        """Severities, failures and seeds of one experiment."""
        severities = generator.uniform(0, 5, (points, self.axes))
        point = np.repeat(np.arange(points), seeds)
        seed = np.tile(np.arange(seeds), points) if seeds > 1 else point % TURNS
        logits = logit(self.rate(severities))
        logits += self.point_spread * generator.normal(size=points)
        chances = expit(logits[point] + self.seed_spread * generator.normal(size=seed.max() + 1)[seed])
        return severities[point], generator.random(len(point)) < chances, seed


def cluster_of(within: float, outside: float) -> Callable[[Array], Array]:
    """Failure rates within and outside the planted cluster."""

    def rate(severities: Array) -> Array:
        return np.where((severities[:, :2] >= LEAST).all(axis=1), within, outside)

    return rate


PAIR = frozenset("ab")
POLICIES = {
    "0.9 in a pair, else 0.1; 4 axes": Policy(4, cluster_of(0.9, 0.1), PAIR),
    "0.9 in a pair, else 0.1; 6 axes": Policy(6, cluster_of(0.9, 0.1), PAIR),
    "the same, seeds differ": Policy(6, cluster_of(0.9, 0.1), PAIR, seed_spread=1.0),
    "0.6 in a pair, else 0.2; 6 axes": Policy(6, cluster_of(0.6, 0.2), PAIR),
    "0.3 everywhere": Policy(6, cluster_of(0.3, 0.3), frozenset()),
    "0.3 everywhere, seeds and points differ": Policy(
        6, cluster_of(0.3, 0.3), frozenset(), seed_spread=1.0, point_spread=2.0
    ),
    "grows along one axis": Policy(6, lambda x: 0.1 + 0.16 * x[:, 0], frozenset("a")),
    "rises steeply along one axis": Policy(6, lambda x: expit(4 * (x[:, 0] - 2.5)), frozenset("a")),
}


def measure() -> list[dict[str, object]]:
    """Shares of experiments in which the planted cluster is found, and in which another is reported."""
    rows = [
        {"policy": name, "design": design, **_row(policy, *DESIGNS[design], number)}
        for number, (design, (name, policy)) in enumerate(product(DESIGNS, POLICIES.items()))
    ]
    columns = {"failure rate": "{policy}", "design": "{design}", "found": "{found_text}", "false": "{false:.1%}"}
    table_of(rows, {**columns, "true rate within interval": "{covered_text}", "clusters": "{clusters:.2f}"})
    return rows


def _row(policy: Policy, points: int, seeds: int, number: int) -> dict[str, object]:
    generator = np.random.default_rng([SEED, number])
    names = list("abcdef")[: policy.axes]
    found, false, covered, count = 0, 0, [], 0
    for _ in range(EXPERIMENTS):
        clusters = failure_clusters(*policy.episodes(points, seeds, generator), names, generator)
        axes = [frozenset(condition.axis for condition in cluster.conditions) for cluster in clusters]
        count += len(clusters)
        # Failure is more frequent along each axis of the planted pair too, so that either alone is no error.
        false += not all(own <= policy.planted for own in axes)
        right = [cluster for cluster, own in zip(clusters, axes, strict=True) if own == policy.planted]
        found += any(_is_near(cluster) for cluster in right)
        covered += list(_covered(policy, right))
    row = {"found": found / EXPERIMENTS, "false": false / EXPERIMENTS, "clusters": count / EXPERIMENTS}
    pair = len(policy.planted) == len(PAIR)
    return {
        **row,
        "covered": float(np.mean(covered)) if covered else None,
        "found_text": f"{row['found']:.1%}" if pair else "",
        "covered_text": f"{np.mean(covered):.1%}" if covered else "",
    }


def _is_near(cluster: Cluster) -> bool:
    return all(abs(condition.threshold - LEAST) <= 1 for condition in cluster.conditions)


def _covered(policy: Policy, clusters: list[Cluster]) -> Iterator[bool]:
    """Whether the interval within a cluster with the planted thresholds contains the true rate."""
    for cluster in clusters:
        if len(cluster.conditions) > 1 and all(condition.threshold == LEAST for condition in cluster.conditions):
            ends = cluster.within.interval
            nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
            rates = expit(logit(policy.rate(np.full((1, policy.axes), 5.0))[0]) + policy.seed_spread * nodes)
            yield ends is not None and ends.low <= float(weights @ rates / weights.sum()) <= ends.high
