"""Evaluation of routers on first observations: answers, latencies, and scores of tasks left out of the fit."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from robogauntlet.policies.contract import Routing
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.routing.catalog import (
    FITTED,
    NAMES,
    FitMethod,
    feature_spec_of,
    fitting_features,
    router,
)
from robogauntlet_mergevla.routing.contract import FirstObservation, Router, RoutingError, named_for
from robogauntlet_mergevla.routing.demonstrations import RouterTrainingSet
from robogauntlet_mergevla.routing.features import LabelledFeatures, labelled_features
from robogauntlet_mergevla.routing.fitted_router import RouterFit

ProgressListener = Callable[[int, int], None]
"""Called with the number done and the number in all."""


@dataclass(frozen=True)
class RoutedObservation:
    """One routed first observation."""

    task: str
    """The true task."""
    routing: Routing


@dataclass(frozen=True)
class RouterAnswers:
    """A router's answers."""

    router: str
    sees_instruction: bool
    passes: int
    """Backbone passes for one decision."""
    answers: tuple[RoutedObservation, ...]


@dataclass(frozen=True)
class RouterEvaluation:
    """All routers on the same observations."""

    pass_s: float
    """Median time of one pass of the base over one observation (s)."""
    routers: tuple[RouterAnswers, ...]


@dataclass(frozen=True)
class LeaveOneOutScores:
    """Scores of a router that was fitted without one task; higher is less like a known task."""

    known: tuple[float, ...]
    """Of observations of the tasks that it was fitted to."""
    unknown: tuple[float, ...]
    """Of observations of the other task."""
    threshold: float
    """Score above which the router rejects."""


@dataclass(frozen=True)
class UnknownTaskScores:
    """A fitted router's scores with each task left out of the fit in turn."""

    router: str
    sees_instruction: bool
    by_task: Mapping[str, LeaveOneOutScores]


def all_routers(stored: Mapping[str, Tensor], wanted: Sequence[str] = ()) -> list[Router]:
    """Return every router of this package, with the instruction and without; fitted ones only if `stored` holds them.

    `wanted` names others than all, with their options. Raises RoutingError for one that does not exist.
    """
    fitted = {key.partition("/")[0] for key in stored}
    names = wanted or [name for name in NAMES if name not in FITTED or name in fitted]
    return [router(name, sees_instruction=sees, stored=stored) for name in names for sees in (True, False)]


def evaluate_routers(
    routers: Sequence[Router],
    model: MergedModel,
    observations: Sequence[FirstObservation],
    *,
    listener: ProgressListener = lambda done, total: None,
    clock: Callable[[], float] = time.perf_counter,
) -> RouterEvaluation:
    """Route each observation by each router, one at a time.

    A pass of the base is timed at every observation, so that other load slows routers and passes alike. Everything that
    is built on first use is built before. The observations are of tasks that have an expert; RoutingError without any.
    `clock` returns a time in s, with any origin.
    """
    if not observations:
        raise RoutingError("expected first observations to route, got none")
    _pass(model, observations[0])
    for tested in routers:
        tested.route(observations[:1], model)
    answers: list[list[RoutedObservation]] = [[] for _ in routers]
    pass_times = []
    for done, observation in enumerate(observations):
        listener(done, len(observations))
        started = clock()
        _pass(model, observation)
        pass_times.append(clock() - started)
        for tested, routed in zip(routers, answers, strict=True):
            started = clock()
            (decision,) = tested.route([observation], model)
            decision = replace(decision, latency_s=clock() - started)
            routed.append(RoutedObservation(observation.task, named_for(decision, observation.task, model)))
    listener(len(observations), len(observations))
    experts = len(model.experts)
    results = (
        RouterAnswers(tested.name, tested.sees_instruction, tested.passes(experts), tuple(routed))
        for tested, routed in zip(routers, answers, strict=True)
    )
    return RouterEvaluation(float(np.median(pass_times)), tuple(results))


def unknown_tasks(
    model: MergedModel,
    training_set: RouterTrainingSet,
    observations: Mapping[str, Sequence[FirstObservation]],
    *,
    listener: ProgressListener = lambda done, total: None,
) -> list[UnknownTaskScores]:
    """Leave each task in turn out of the fit of every router fitted to tasks, and score new observations of all tasks.

    Args:
        model: Merged model, of which only the base is run.
        training_set: Observations of all experts to fit to.
        observations: Task to new observations; RoutingError for fewer than two tasks.
        listener: Called with the number of routers done and in all.
    """
    scores: list[UnknownTaskScores] = []
    methods = {name: fitting for name, fitting in FITTED.items() if isinstance(fitting, FitMethod)}
    total = 2 * len(methods)
    for sees_instruction in (True, False):
        listener(len(scores), total)
        feature_spec = feature_spec_of(model.architecture, sees_instruction=sees_instruction)
        new = labelled_features(model, observations, feature_spec)
        for name, fitting in methods.items():
            parts = fitting_features(fitting, model, training_set.frames, training_set.held_out, feature_spec)
            by_task = leave_one_out(partial(fitting.fit, feature_spec=feature_spec), *parts, new)
            scores.append(UnknownTaskScores(name, sees_instruction, by_task))
    return sorted(scores, key=lambda each: each.router)


def leave_one_out(
    fit: Callable[[LabelledFeatures, LabelledFeatures], RouterFit],
    frames: LabelledFeatures,
    held_out: LabelledFeatures,
    observations: LabelledFeatures,
) -> dict[str, LeaveOneOutScores]:
    """Leave each expert out of the fit, and score its observations and those of the others.

    Args:
        fit: A fit such as `gaussian.fit`, with its options bound.
        frames: Features to fit to.
        held_out: Features of the same experts, for the threshold.
        observations: Features to score, of two or more of these experts; RoutingError otherwise.
    """
    if len(observations.experts) < 2 or not set(observations.experts) <= set(frames.experts):
        expected, given = ", ".join(frames.experts), ", ".join(observations.experts)
        raise RoutingError(f"expected observations of two or more of {expected} to score, got {given or 'none'}")
    by_expert = {}
    for expert in observations.experts:
        fitted = fit(frames.without(expert), held_out.without(expert))
        known, unknown = (
            fitted.unknown(x).tolist() for x in (observations.without(expert).features, observations.of(expert))
        )
        by_expert[expert] = LeaveOneOutScores(tuple(known), tuple(unknown), fitted.threshold)
    return by_expert


@torch.no_grad()
def _pass(model: MergedModel, observation: FirstObservation) -> None:
    """Run the base on one observation and wait for the result."""
    model.hidden_states(None, observation.images[None], [observation.instruction]).action[-1].sum().item()
