"""Collects demonstrations: the oracle plays many seeds of each task, and its successes become a dataset per task.

A learner may act first in each episode (see `robogauntlet.orchestrator.demonstrations.recorder`).
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.demonstrations.progress import DemonstrationProgress
from robogauntlet.orchestrator.demonstrations.task_queue import CollectionQueue, CollectionTask, PlayedSeed
from robogauntlet.orchestrator.demonstrations.variation import Variation
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.ray_runtime.session import RayLost, ray_session
from robogauntlet.orchestrator.registry import find_suite, load_registry
from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerObserver, SchedulerOptions
from robogauntlet.orchestrator.scheduling.worker_pool import WorkerPoolError
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.oracles import digest_of_task
from robogauntlet.policies.references import read_reference
from robogauntlet.policies.training.dataset_writer import DatasetWriter
from robogauntlet.results.folder_lock import lock_folder
from robogauntlet.results.live_status import LiveWorker
from robogauntlet.results.run_document import RunStatus
from robogauntlet.suites.episode import CAMERAS, FIRST_TRAINING_SEED, Cell, Protocol, RenderProfile, View, content_hash
from robogauntlet.suites.loading import load_suite
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.ranges import MAX_FIRST_SEED
from robogauntlet.suites.schema import PolicyEntry, expand_tasks
from robogauntlet.support.errors import BadInput, describe_os_error
from robogauntlet.support.interrupts import deferred_interrupts

ORACLE = "oracle"
NOISE = 0.1
EPISODE_TIME_LIMIT_S = 420.0
"""Duration of an episode after which its worker is considered hung."""
DEFAULT_VIEW = View(CAMERAS, 96, RenderProfile.FAST)


class DemonstrateError(BadInput):
    """A collection request is invalid; one line per problem."""


@dataclass(frozen=True)
class CollectionRequest:
    """The demonstrations to collect."""

    tasks: tuple[str, ...]
    episodes: int
    """Successful episodes per task."""
    view: View = DEFAULT_VIEW
    noise: float = NOISE
    """Deviation of the executed motion per axis, as a share of the largest motion in one step."""
    first_seed: int = FIRST_TRAINING_SEED
    workers: int = 2
    learner: str | None = None
    """Policy that acts first in each episode, as `read_reference` reads it; None for the oracle alone."""
    whole: bool = False
    """Whether the oracle's actions are also recorded while a learner acts."""
    variation: Variation = field(default_factory=lambda: Variation({}))
    """Perturbations of the episodes."""

    @property
    def entry(self) -> PolicyEntry | None:
        """The learner's kind and options. Raises BadInput or PolicyError if there is no such policy."""
        return read_reference(self.learner) if self.learner is not None else None

    def problems(self) -> list[str]:
        """The request's mistakes, a line each."""
        known = load_registry().tasks
        scripted = policies.find(ORACLE).tasks
        can = set(self.tasks) & (scripted() if scripted else set(self.tasks))
        problems = [f"unknown task '{task}'{did_you_mean(task, known)}" for task in self.tasks if task not in known]
        unscripted = [task for task in self.tasks if task in known and task not in can]
        problems += [f"the oracle has no script for '{task}'" for task in unscripted]
        try:
            if (learner := self.entry) is not None:
                spec = policies.spec(learner.kind, learner.options)
                problems += [f"the learner cannot act in '{task}'" for task in sorted(can) if not spec.can_act_in(task)]
        except (BadInput, PolicyError) as error:
            problems.append(f"learner: {error}")
        if self.whole and self.learner is None:
            problems.append("whole: expected a learner whose part of the episode is to be recorded, got none")
        if not self.tasks:
            problems.append("expected at least one task, got none")
        for name, value, low, high in (
            ("episodes", self.episodes, 1, 100_000),
            ("noise", self.noise, 0, 1),
            ("first seed", self.first_seed, 0, MAX_FIRST_SEED),
            ("workers", self.workers, 1, 256),
            ("image size", self.view.image_size, 16, 1024),
        ):
            if not low <= value <= high:
                problems.append(f"{name}: expected {low} to {high}, got {value:g}")
        wrong = [camera for camera in self.view.cameras if camera not in CAMERAS]
        if wrong or not self.view.cameras:
            problems.append(f"camera: expected {' or '.join(CAMERAS)}, got {wrong[0] if wrong else 'none'}")
        return problems


@dataclass
class CollectionResult:
    """The outcome of a collection."""

    status: RunStatus = RunStatus.COMPLETE
    warnings: list[str] = field(default_factory=list)
    """Messages for the user, a line each."""
    tasks: list[CollectionTask] = field(default_factory=list)
    seconds: float = 0.0


def resolve(names: Sequence[str]) -> tuple[tuple[str, ...], View]:
    """Resolve names of suites and tasks and patterns of tasks (`pybullet/*`) into tasks and a view.

    The view is the first suite's, so that training and evaluation use the same images; by default `DEFAULT_VIEW`.

    Raises:
        SuiteError: A suite file is wrong.
    """
    known = load_registry()
    tasks: list[str] = []
    view = None
    for name in names:
        if name in known.tasks or ("*" in name and not Path(name).exists()):
            tasks += expand_tasks([name], known.tasks) or [name]
        elif name.partition("/")[0] in known.simulators and not Path(name).exists():
            tasks.append(name)
        else:
            suite = load_suite(find_suite(name), known)
            tasks += suite.tasks
            view = view or View(suite.cameras, suite.image_size, suite.render_profile)
    return tuple(dict.fromkeys(tasks)), view or DEFAULT_VIEW


def collect(request: CollectionRequest, folder: Path, display: DemonstrationProgress) -> CollectionResult:
    """Collect the missing demonstrations into `folder`, a dataset per task.

    An interruption or a full disk ends the collection early. The committed episodes are kept, and collecting again
    continues. The data depend on the request alone, not on the number of workers, their speed, or interruptions.

    Raises:
        DemonstrateError: The request is invalid, or none of its simulators is installed.
        DatasetError: The folder contains other data.
        FolderError: The folder cannot be written, or another process writes into it.
    """
    problems = request.problems()
    if problems:
        raise DemonstrateError("\n".join(problems))
    names = dict.fromkeys(task.partition("/")[0] for task in request.tasks)
    environments = EnvironmentResolver()
    absent = {name: reason for name in names if (reason := environments.missing_reason(simulators.find(name)))}
    if len(absent) == len(names):
        raise DemonstrateError("\n".join(f"{name}: {reason}" for name, reason in absent.items()))
    began = time.monotonic()
    with lock_folder(folder):
        tasks = [_open_task(task, request, folder, environments) for task in request.tasks]
        for task in tasks:
            if task.cell.simulator in absent:
                task.give_up(absent[task.cell.simulator])
        collected = CollectionResult(tasks=tasks)
        display.begin(tasks)
        _play(request, collected, display, environments)
        collected.warnings += [f"{task.name}: {task.reason}" for task in tasks if task.reason]
        if collected.status is RunStatus.COMPLETE and any(task.kept < task.episodes for task in tasks):
            collected.status = RunStatus.STOPPED
    collected.seconds = time.monotonic() - began
    return collected


class _Observer(SchedulerObserver[PlayedSeed]):
    """Commits played episodes."""

    def __init__(self, tasks: Sequence[CollectionTask], display: DemonstrationProgress) -> None:
        self._tasks, self._display = tasks, display

    def on_skipped(self, simulator: str, reason: str, episodes: int) -> None:
        """Show the reason."""
        self._display.log(f"{simulator}: {reason}")

    def on_warning(self, message: str) -> None:
        """Show the message."""
        self._display.log(message)

    def on_tick(self, activity: Callable[[], Sequence[LiveWorker]]) -> None:
        """Commit, and update the display."""
        for task in self._tasks:
            task.flush_if_due()
        self._display.show(self._tasks)


def _play(
    request: CollectionRequest,
    collected: CollectionResult,
    display: DemonstrationProgress,
    environments: EnvironmentResolver,
) -> None:
    from robogauntlet.orchestrator.demonstrations.recorder import DemonstrationJob
    from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool

    tasks = [task for task in collected.tasks if task.open]
    if not tasks:
        return
    names = dict.fromkeys(task.cell.simulator for task in tasks)
    work = {name: CollectionQueue(task for task in tasks if task.cell.simulator == name) for name in names}
    learner = PolicySource(entry.kind, entry.options) if (entry := request.entry) is not None else None
    job = DemonstrationJob(request.noise, learner, whole=request.whole, variation=request.variation)
    options = SchedulerOptions(lambda: request.workers, EPISODE_TIME_LIMIT_S, allowed_errors=sys.maxsize)
    # Flushing commits the seeds before the first gap; those after it are played again in another session.
    with recording(collected, [task.writer for task in tasks]), ray_session(address=None, workers=request.workers):
        pool = RayWorkerPool({ORACLE: PolicySource(ORACLE)}, environments=environments, job=job)
        observer = _Observer(collected.tasks, display)
        Scheduler(work, pool, options, sink=lambda results: None, observer=observer).run()


@contextmanager
def recording(result: CollectionResult, writers: Iterable[DatasetWriter]) -> Iterator[None]:
    """Flush the writers after the block. Note in the result if an interruption or a failure ended the block early."""
    try:
        try:
            yield
        finally:
            with deferred_interrupts():
                for writer in writers:
                    writer.flush()
    except KeyboardInterrupt:
        result.status = RunStatus.INTERRUPTED
    except (OSError, RayLost, WorkerPoolError) as error:
        result.status = RunStatus.STOPPED
        result.warnings.append(describe_os_error(error))


def _open_task(
    task: str, request: CollectionRequest, folder: Path, environments: EnvironmentResolver
) -> CollectionTask:
    """A task to collect, with its dataset, which may exist already."""
    description = simulators.task_descriptions()[task]
    made_by: dict[str, Any] = {"oracle": digest_of_task(task), "noise": request.noise}
    horizon = description.horizon
    if request.variation.highest:
        made_by["vary"] = dict(request.variation.highest)
    if (learner := request.entry) is not None:
        made_by["learner"] = policies.digest_in(learner.kind, learner.options, task)
        if request.whole:
            made_by["whole"] = True
        horizon *= 2  # the oracle gets as many steps as without the learner
    cell = Cell(ORACLE, content_hash(made_by), task, Protocol(horizon, 1, request.view))
    source = {
        "task": task,
        **made_by,
        "first_seed": request.first_seed,
        "protocol": cell.protocol.described(),
        "versions": environments.versions(simulators.find(cell.simulator)),
    }
    writer = DatasetWriter(folder / dataset_name(task), source)
    return CollectionTask(cell, request.episodes, request.first_seed, writer)


def dataset_name(task: str) -> str:
    """Name of the folder of a task's dataset."""
    return task.replace("/", "__")


def folder_size(folder: Path) -> int:
    """Total size of the files in a folder (bytes)."""
    return sum(os.path.getsize(path) for path in folder.rglob("*") if path.is_file())  # noqa: PTH202
