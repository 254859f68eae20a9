"""How well a router routes, from its answers and the true tasks. Pure: neither model nor simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from adapters.contract import FloatArray
from policies.mergevla.routing.contract import Routed, RoutingError
from policies.mergevla.routing.features import Labelled

BINS = 15
"""Of equal width, in which confidence is compared with accuracy."""
TRUE_POSITIVE_RATE = 0.95
CERTAIN = 1e-3
"""How far from 1 the sum of exponentiated scores may be for them to be log-probabilities."""


@dataclass(frozen=True)
class Trial:
    """One routed episode."""

    task: str
    """The true one."""
    routed: Routed
    latency_s: float | None = None


@dataclass(frozen=True)
class Count:
    """Episodes of a task."""

    right: int
    """Given to the task's own expert."""
    trials: int


@dataclass(frozen=True)
class Calibrated:
    """How far probabilities can be trusted."""

    expected_error: float
    """Mean over the episodes of |confidence - accuracy| of their bin (C. Guo et al., arXiv 1706.04599)."""
    brier: float
    """Mean of the squared distance between probabilities and truth, 0 to 2 (Brier, Monthly Weather Rev. 78, 1950)."""


@dataclass(frozen=True)
class Latency:
    """Seconds per decision."""

    median_s: float
    p95_s: float
    longest_s: float


@dataclass(frozen=True)
class Study:
    """What a router did on episodes of tasks that have an expert."""

    total: Count
    by_task: Mapping[str, Count]
    confusion: Mapping[str, Mapping[str, int]]
    """True task to chosen expert to episodes; every expert is named."""
    rejected: int | None
    """Episodes that were called unknown; None if the router never does."""
    calibrated: Calibrated | None
    """None if scores are no probabilities."""
    latency: Latency | None


@dataclass(frozen=True)
class Detection:
    """How well a score tells unknown tasks (positive) from known ones (negative)."""

    auroc: float
    """Probability that an unknown one's score is higher, ties counting half (Hanley and McNeil, Radiology 1982)."""
    false_positive_rate: float
    """Share of known ones called unknown at the highest threshold that finds 95 % of the unknown ones."""
    known: int
    unknown: int
    rejected: float | None = None
    """Share of the unknown ones beyond the router's own threshold; None without one."""
    false_alarms: float | None = None
    """Share of the known ones beyond it."""


@dataclass(frozen=True)
class LeftOut:
    """Each task in turn unknown."""

    by_task: Mapping[str, Detection]
    auroc: float
    """Mean over the tasks."""
    false_positive_rate: float
    """Mean over the tasks."""
    rejected: float
    """Mean over the tasks."""
    false_alarms: float
    """Mean over the tasks."""


class Scorer(Protocol):
    """A fitted router's say in what is unknown."""

    @property
    def threshold(self) -> float:
        """Score above which a sighting is rejected."""

    def unknown(self, features: Tensor) -> Tensor:
        """Score of features (n, d), shape (n,), higher is less like a known task."""


def study(trials: Sequence[Trial]) -> Study:
    """Judge a router.

    Raises:
        RoutingError: No episodes, answers over different experts, or a task without an expert (see `detection`).
    """
    if not trials:
        raise RoutingError("expected routed episodes, got none")
    experts = sorted(trials[0].routed.scores)
    for trial in trials:
        if sorted(trial.routed.scores) != experts:
            raise RoutingError(f"expected scores over {', '.join(experts)}, got {', '.join(trial.routed.scores)}")
        if trial.task not in experts:
            raise RoutingError(f"expected episodes of tasks that have an expert, got one of '{trial.task}'")
    tasks = sorted({trial.task for trial in trials})
    confusion = {task: dict.fromkeys(experts, 0) for task in tasks}
    for trial in trials:
        confusion[trial.task][trial.routed.choice] += 1
    by_task = {task: Count(row[task], sum(row.values())) for task, row in confusion.items()}
    said = [trial.routed.rejected for trial in trials if trial.routed.rejected is not None]
    return Study(
        total=Count(sum(count.right for count in by_task.values()), len(trials)),
        by_task=by_task,
        confusion=confusion,
        rejected=sum(said) if said else None,
        calibrated=_calibrated(trials, experts),
        latency=_latency([trial.latency_s for trial in trials if trial.latency_s is not None]),
    )


def detection(known: Iterable[float], unknown: Iterable[float], *, threshold: float | None = None) -> Detection:
    """Compare the unknown scores of sightings of known tasks with those of unknown ones.

    Args:
        known: Scores of sightings of known tasks.
        unknown: Those of unknown ones.
        threshold: Above which the router rejects, if it does.

    Raises:
        RoutingError: One of the two is empty, or a score is not finite.
    """
    from sklearn.metrics import roc_auc_score, roc_curve

    negative, positive = (np.asarray(list(scores), dtype=np.float64) for scores in (known, unknown))
    if not len(negative) or not len(positive):
        raise RoutingError(f"expected scores of known and unknown tasks, got {len(negative)} and {len(positive)}")
    both = np.concatenate([negative, positive])
    if not np.isfinite(both).all():
        raise RoutingError("expected finite scores, got NaN or infinity")
    truth = np.repeat([False, True], [len(negative), len(positive)])
    false_positives, true_positives, _ = roc_curve(truth, both, drop_intermediate=False)
    return Detection(
        auroc=float(roc_auc_score(truth, both)),
        false_positive_rate=float(false_positives[np.argmax(true_positives >= TRUE_POSITIVE_RATE - 1e-9)]),
        known=len(negative),
        unknown=len(positive),
        rejected=None if threshold is None else float((positive > threshold).mean()),
        false_alarms=None if threshold is None else float((negative > threshold).mean()),
    )


def leave_one_out(
    fit: Callable[[Labelled, Labelled], Scorer], frames: Labelled, held_out: Labelled, judged: Labelled | None = None
) -> LeftOut:
    """Leave each expert out of the fit, then tell its sightings from those of the others.

    Args:
        fit: Such as `gaussian.fit`, with its options.
        frames: To fit on. Features are computed once; a fit takes a second.
        held_out: Of the same experts, for the threshold.
        judged: Other sightings of some of these experts, to be told apart. Without them, the known ones are held-out
            ones, to which the threshold was fitted, and the unknown ones are all of the left-out expert.

    Raises:
        RoutingError: Fewer than two experts, or judged sightings of fewer than two or of others.
    """
    if len(frames.experts) < 2:
        raise RoutingError(f"expected two experts or more, got {', '.join(frames.experts) or 'none'}")
    if judged is not None and (len(judged.experts) < 2 or not set(judged.experts) <= set(frames.experts)):
        wanted, came = ", ".join(frames.experts), ", ".join(judged.experts)
        raise RoutingError(f"expected sightings of two or more of {wanted} to judge by, got {came or 'none'}")
    found: dict[str, Detection] = {}
    for expert in (judged or frames).experts:
        others = held_out.without(expert)
        scorer = fit(frames.without(expert), others)
        if judged is None:
            # None of the left-out task's sightings were fitted to, so that all of them count.
            known, unseen = others.features, torch.cat([frames.of(expert), held_out.of(expert)])
        else:
            known, unseen = judged.without(expert).features, judged.of(expert)
        found[expert] = detection(
            scorer.unknown(known).tolist(), scorer.unknown(unseen).tolist(), threshold=scorer.threshold
        )
    return LeftOut(
        by_task=found,
        auroc=float(np.mean([one.auroc for one in found.values()])),
        false_positive_rate=float(np.mean([one.false_positive_rate for one in found.values()])),
        rejected=float(np.mean([one.rejected or 0.0 for one in found.values()])),
        false_alarms=float(np.mean([one.false_alarms or 0.0 for one in found.values()])),
    )


def _calibrated(trials: Sequence[Trial], experts: Sequence[str]) -> Calibrated | None:
    probabilities = np.exp([[trial.routed.scores[expert] for expert in experts] for trial in trials])
    if not np.allclose(probabilities.sum(axis=1), 1.0, atol=CERTAIN):
        return None
    truth = np.array([[trial.task == expert for expert in experts] for trial in trials], dtype=np.float64)
    confidence = probabilities.max(axis=1)
    right = np.array([trial.routed.choice == trial.task for trial in trials], dtype=np.float64)
    return Calibrated(
        expected_error=_expected_error(confidence, right),
        brier=float(np.square(probabilities - truth).sum(axis=1).mean()),
    )


def _expected_error(confidence: FloatArray, right: FloatArray) -> float:
    """Sum over the bins of |sum of confidence - sum of right|, per episode."""
    place = np.minimum((confidence * BINS).astype(int), BINS - 1)
    gaps = np.bincount(place, confidence, BINS) - np.bincount(place, right, BINS)
    return float(np.abs(gaps).sum() / len(confidence))


def _latency(seconds: Sequence[float]) -> Latency | None:
    if not seconds:
        return None
    median, p95 = np.quantile(seconds, [0.5, 0.95])
    return Latency(float(median), float(p95), float(max(seconds)))
