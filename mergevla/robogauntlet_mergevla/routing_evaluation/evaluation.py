"""Evaluates how well each router of a merged model infers the task from first observations.

The metrics are those of a run's report: answers become the columns that `robogauntlet.results.analysis.routing` reads.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path

import pandas as pd
import torch

from robogauntlet.orchestrator.episodes.rollout import routing_fields
from robogauntlet.orchestrator.registry import load_registry
from robogauntlet.policies.contract import check_routing
from robogauntlet.policies.training.dataset import datasets_of
from robogauntlet.results.analysis.routing import Detection, Router, detection, router_of
from robogauntlet.suites.episode import RenderProfile, View
from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.routing.demonstrations import first_observations
from robogauntlet_mergevla.routing.evaluation import (
    LeaveOneOutScores,
    RoutedObservation,
    all_routers,
    evaluate_routers,
    unknown_tasks,
)
from robogauntlet_mergevla.routing_evaluation.first_observations import (
    FirstObservationError,
    Listener,
    collect_first_observations,
)


@dataclass(frozen=True)
class RoutingStudyRequest:
    """The checkpoint and the episodes to evaluate its routers on."""

    checkpoint: str
    """Folder or hub id of a merged checkpoint."""
    seeds: range
    """Seeds of the episodes, which are clean and not used in training."""
    keep: Path | None = None
    """Folder in which first observations are cached."""
    demonstrations: tuple[Path, ...] = ()
    """Datasets, or folders of them, for the evaluation on tasks that are left out of the fit."""
    routers: tuple[str, ...] = ()
    """Routers to evaluate, with their options; by default all."""


@dataclass(frozen=True)
class RouterResult:
    """One router on all first observations."""

    router: str
    sees_instruction: bool
    passes: int
    """Backbone passes for one decision."""
    quality: Router
    latency_in_passes: float
    """Median time of a decision divided by that of a backbone pass."""


@dataclass(frozen=True)
class UnknownResult:
    """How well a fitted router detects tasks that it was not fitted to."""

    router: str
    sees_instruction: bool
    by_task: Mapping[str, Detection]
    """Task that was left out of the fit, to the separation of its first observations from those of the others."""


@dataclass(frozen=True)
class RoutingStudy:
    """The results of a study."""

    request: RoutingStudyRequest
    digest: str
    """Hash of the merged model."""
    view: View
    tasks: tuple[str, ...]
    """Evaluated tasks."""
    skipped: dict[str, str]
    """Simulator that is not installed here, to the reason."""
    unfitted: bool
    """Whether the checkpoint has no fitted routers."""
    pass_s: float
    """Median time of one backbone pass over one first observation (s)."""
    routers: tuple[RouterResult, ...]
    unknown: tuple[UnknownResult, ...]
    """Empty without demonstrations."""


def study_routing(request: RoutingStudyRequest, listener: Listener) -> RoutingStudy:
    """Evaluate all routers on first observations of the model's tasks, with one thread, like a policy in a worker.

    Raises:
        PolicyError: The checkpoint or the demonstrations cannot be used.
        FirstObservationError: A task cannot be observed, or some of its seeds start alike.
        OSError: The cache of first observations cannot be written.
    """
    torch.set_num_threads(1)
    checkpoint = load_merged(request.checkpoint)
    metadata, routers, training_set = checkpoint.metadata, all_routers(checkpoint.fitted, request.routers), None
    tasks = tuple(chain.from_iterable(metadata.tasks.values()))
    known = load_registry().tasks
    for task in tasks:
        if task in known and (why := known[task].why_repeated(request.seeds)):
            raise FirstObservationError(f"{task}: {why}")
    if request.demonstrations:  # first, because it finds mistakes early
        datasets = datasets_of(request.demonstrations, tasks)
        training_set = first_observations(datasets, checkpoint.parts.architecture.cameras)
    view = View(metadata.architecture.cameras, metadata.architecture.image_size, RenderProfile.FAST)
    with ExitStack() as stack:
        folder = request.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        collected = collect_first_observations(tasks, view, request.seeds, folder, listener)
    observations = {task: cache.observations(request.seeds) for task, cache in collected.by_task.items()}
    model = MergedModel(checkpoint.parts)
    evaluation = evaluate_routers(
        routers, model, list(chain(*observations.values())), listener=partial(listener, "routing")
    )
    routed = []
    for router in evaluation.routers:
        quality = quality_of(router.answers)
        latency_in_passes = quality.latency.median_s / evaluation.pass_s
        routed.append(RouterResult(router.router, router.sees_instruction, router.passes, quality, latency_in_passes))
    unknown = []
    if training_set:
        for left_out in unknown_tasks(
            model, training_set, observations, listener=partial(listener, "leaving tasks out")
        ):
            by_task = {task: detection_of(scores) for task, scores in left_out.by_task.items()}
            unknown.append(UnknownResult(left_out.router, left_out.sees_instruction, by_task))
    return RoutingStudy(
        request=request,
        digest=metadata.digest,
        view=view,
        tasks=tuple(observations),
        skipped=collected.skipped,
        unfitted=not checkpoint.fitted,
        pass_s=evaluation.pass_s,
        routers=tuple(routed),
        unknown=tuple(unknown),
    )


def quality_of(trials: Sequence[RoutedObservation]) -> Router:
    """A router's metrics, computed from its answers like from a run's rows."""
    rows = [
        {"simulator": trial.task.partition("/")[0], "task": trial.task, **routing_fields(check_routing(trial.routing))}
        for trial in trials
    ]
    quality = router_of(pd.DataFrame(rows))
    assert quality is not None
    return quality


def detection_of(scores: LeaveOneOutScores) -> Detection:
    """How well these scores separate the left-out task from the others."""
    known, unknown = (
        pd.DataFrame({"unknown_score": values, "rejected": [value > scores.threshold for value in values]})
        for values in (scores.known, scores.unknown)
    )
    result = detection(known, unknown)
    assert result is not None
    return result
