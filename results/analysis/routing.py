"""Metrics of a router: accuracy, confusion, calibration, latency and rejection of unknown tasks.

The report of a run computes them from its rows, and `robogauntlet mergevla routing` from first observations.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from robogauntlet.results.statistics.rates import Interval, rate, wilson_interval

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

SCENE_PAIRS = (("PandaPush", "PandaPickAndPlace"), ("PushCube", "PullCube"))
"""Tasks (without their version) that share a scene and differ at most in the place of the goal, so that they are hard
to distinguish from the first image."""
BINS = 15
"""Number of bins of equal width, upper edges included, for the calibration error and the reliability diagram, as in
C. Guo et al., "On calibration of modern neural networks" (ICML 2017, arXiv 1706.04599)."""
LARGEST_CONFUSION = 60
"""Tasks in a matrix: a suite can have thousands."""
SUMS_TO_ONE = 1e-3
"""Largest distance from 1 of the sum of the probabilities of an episode (scores are rounded to 1e-6)."""


@dataclass(frozen=True, slots=True)
class Rate:
    """A share of trials with its Wilson interval, 95 %."""

    successes: int
    trials: int
    rate: float | None
    interval: Interval | None

    @classmethod
    def from_counts(cls, successes: int, trials: int) -> Rate:
        """The rate of these counts."""
        return cls(successes, trials, rate(successes, trials), wilson_interval(successes, trials))


@dataclass(frozen=True, slots=True)
class ScenePair:
    """Two tasks that share a scene."""

    tasks: tuple[str, str]
    accuracy: Rate
    """On the episodes of the two."""
    mistaken: int
    """Episodes of one task in which the other was inferred."""


@dataclass(frozen=True, slots=True)
class Confusion:
    """Number of episodes by true and inferred task, of `LARGEST_CONFUSION` tasks at most, the most mistaken."""

    true: tuple[str, ...]
    inferred: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    """A row per true task, a column per inferred one."""


@dataclass(frozen=True, slots=True)
class ConfidenceBin:
    """Episodes in which the chosen task had about the same probability."""

    low: float
    high: float
    episodes: int
    confidence: float
    """Mean probability of the chosen task."""
    accuracy: Rate


@dataclass(frozen=True, slots=True)
class Calibration:
    """Agreement of the router's probabilities with its accuracy."""

    expected_error: float
    """Expected calibration error: mean distance of confidence and accuracy over the bins, weighted by episodes."""
    brier: float
    """Brier score: mean over episodes of the sum over tasks of (probability - truth)²; 0 is perfect, 2 the worst."""
    bins: tuple[ConfidenceBin, ...]
    """Those with episodes, of equal width."""


@dataclass(frozen=True, slots=True)
class Latency:
    """Time to infer a task (s)."""

    median_s: float
    p95_s: float


@dataclass(frozen=True, slots=True)
class Detection:
    """Detection of tasks that the router does not know, by its score for an unknown task."""

    known: int
    unknown: int
    """Episodes."""
    auroc: float
    """Probability that an unknown task's episode scores higher than a known one's, ties counting half."""
    false_positives: float
    """Share of known episodes at or above the highest score that 95 % of the unknown reach."""
    rejected: Rate | None
    """Unknown episodes above the router's own threshold, if it has one."""
    false_alarms: Rate | None
    """Known episodes above it."""


@dataclass(frozen=True, slots=True)
class Router:
    """One routing policy over the episodes in which it inferred a task."""

    accuracy: Rate
    """On tasks that it knows."""
    simulators: tuple[tuple[str, Rate], ...]
    tasks: tuple[tuple[str, Rate], ...]
    scene_pairs: tuple[ScenePair, ...]
    confusion: Confusion
    calibration: Calibration | None
    """None if the scores are no logarithms of probabilities."""
    latency: Latency
    rejected: Rate | None
    """Known tasks that the router rejected, if it can reject."""
    detection: Detection | None
    """None without episodes of unknown tasks."""


def router_of(frame: pd.DataFrame) -> Router | None:
    """Compute the metrics of a router from the rows of its policy; None if no task was inferred.

    The columns are `simulator`, `task`, `inferred_task`, `routing_scores`, `unknown_score`, `rejected` and `routing_s`.
    A task is unknown to the router if it is not among those scored.
    """
    import numpy as np

    routed = frame.loc[frame["inferred_task"].notna()]
    if routed.empty:
        return None
    scores = [json.loads(text) if isinstance(text, str) else {} for text in routed["routing_scores"]]
    is_known = [not line or task in line for line, task in zip(scores, routed["task"], strict=True)]
    known = routed.loc[is_known]
    right = known["task"].astype(str) == known["inferred_task"].astype(str)
    kept = [line for line, yes in zip(scores, is_known, strict=True) if yes]
    latency = np.quantile(routed["routing_s"].to_numpy(dtype=float), [0.5, 0.95]).tolist()
    return Router(
        accuracy=Rate.from_counts(int(right.sum()), len(right)),
        simulators=_by(known["simulator"], right),
        tasks=_by(known["task"], right),
        scene_pairs=_scene_pairs(known, right),
        confusion=_confusion(routed, set().union(*scores)),
        calibration=calibration(kept, known["task"].astype(str).tolist(), known["inferred_task"].astype(str).tolist()),
        latency=Latency(*latency),
        rejected=_rejected(known),
        detection=detection(known, routed.loc[[not yes for yes in is_known]]),
    )


def _by(names: pd.Series, right: pd.Series) -> tuple[tuple[str, Rate], ...]:
    groups = right.groupby(names.astype(str), sort=False)
    return tuple((str(name), Rate.from_counts(int(group.sum()), len(group))) for name, group in groups)


def _scene_pairs(known: pd.DataFrame, right: pd.Series) -> tuple[ScenePair, ...]:
    found = []
    tasks = {plain_task(task): task for task in known["task"].astype(str).unique()}
    for pair in SCENE_PAIRS:
        if all(name in tasks for name in pair):
            names = (tasks[pair[0]], tasks[pair[1]])
            inside = known["task"].astype(str).isin(names)
            mistaken = inside & ~right & known["inferred_task"].astype(str).isin(names)
            found.append(
                ScenePair(names, Rate.from_counts(int(right[inside].sum()), int(inside.sum())), int(mistaken.sum()))
            )
    return tuple(found)


def plain_task(task: str) -> str:
    """`pybullet/PandaPush-v3` as `PandaPush`."""
    return re.sub(r"-v\d+$", "", task.rpartition("/")[2])


def _confusion(routed: pd.DataFrame, scored: set[str]) -> Confusion:
    true, inferred = routed["task"].astype(str), routed["inferred_task"].astype(str)
    counts = routed.groupby([true, inferred]).size()
    tasks = list(dict.fromkeys(true))
    if len(tasks) > LARGEST_CONFUSION:
        wrong = Counter(true[true != inferred])
        tasks = sorted(tasks, key=lambda task: -wrong[task])[:LARGEST_CONFUSION]
    chosen = set(inferred[true.isin(tasks)])
    # A task that is unknown to the router is never inferred and needs no column; a known one has one even if empty.
    columns = [task for task in tasks if task in chosen or task in scored or not scored]
    columns += sorted(chosen - set(tasks))
    lines = tuple(tuple(int(counts.get((task, column), 0)) for column in columns) for task in tasks)
    return Confusion(tuple(tasks), tuple(columns), lines)


def calibration(
    scores: Sequence[Mapping[str, float]], true: Sequence[str], inferred: Sequence[str]
) -> Calibration | None:
    """Expected calibration error over `BINS` and Brier score of a router, from scores by task for each episode.

    G. W. Brier, "Verification of forecasts expressed in terms of probability", Monthly Weather Review 78 (1950).

    Returns:
        None without episodes, or unless the exponentials of every episode's scores add up to 1.
    """
    import numpy as np

    probabilities = [{name: math.exp(min(score, 1.0)) for name, score in line.items()} for line in scores]
    if not probabilities or any(abs(sum(line.values()) - 1) > SUMS_TO_ONE for line in probabilities):
        return None
    lines = list(zip(probabilities, true, inferred, strict=True))
    confidence = np.array([line.get(choice, 0.0) for line, _, choice in lines])
    right = np.array([task == choice for _, task, choice in lines])
    distance = [sum((p - (name == task)) ** 2 for name, p in line.items()) for line, task, _ in lines]
    bins = _bins(confidence, right)
    apart = sum(b.episodes * abs(b.confidence - b.accuracy.successes / b.episodes) for b in bins)
    return Calibration(apart / len(lines), float(np.mean(distance)), bins)


def _bins(confidence: np.ndarray, right: np.ndarray) -> tuple[ConfidenceBin, ...]:
    import numpy as np

    edges = [i / BINS for i in range(BINS + 1)]
    # Upper edges belong to their bin; exponentials of rounded scores may be a little above 1.
    place = np.clip(np.ceil(confidence * BINS).astype(int) - 1, 0, BINS - 1)
    return tuple(
        ConfidenceBin(
            low,
            high,
            int(inside.sum()),
            float(min(confidence[inside].mean(), 1.0)),
            Rate.from_counts(int(right[inside].sum()), int(inside.sum())),
        )
        for i, (low, high) in enumerate(pairwise(edges))
        if (inside := place == i).any()
    )


def _rejected(rows: pd.DataFrame) -> Rate | None:
    rejected = rows["rejected"].dropna()
    return Rate.from_counts(int(rejected.astype(bool).sum()), len(rejected)) if len(rejected) else None


def detection(known: pd.DataFrame, unknown: pd.DataFrame) -> Detection | None:
    """Compare `unknown_score` and `rejected` in rows of known and unknown tasks; None if either has no scores.

    AUROC: J. A. Hanley and B. J. McNeil, Radiology 143 (1982).
    """
    import numpy as np
    from scipy.stats import rankdata

    usual = known["unknown_score"].dropna().to_numpy(dtype=float)
    strange = unknown["unknown_score"].dropna().to_numpy(dtype=float)
    n, m = len(usual), len(strange)
    if not n or not m:
        return None
    # The Mann-Whitney statistic of the ranks, divided by the number of (known, unknown) pairs.
    above = rankdata(np.concatenate([strange, usual]))[:m].sum() - m * (m + 1) / 2
    threshold = np.sort(strange)[m // 20]  # at most 5 % of the unknown are below
    false_positives = float((usual >= threshold).mean())
    return Detection(n, m, float(above / (n * m)), false_positives, _rejected(unknown), _rejected(known))
