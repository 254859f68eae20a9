"""Collects demonstrations: the oracle plays many seeds of each task, and its successes become a dataset per task.

With a learner, the oracle takes over from it (see `orchestrator.recording`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adapters import catalog as simulators
from orchestrator.cluster import RayLost, ray_session
from orchestrator.environments.homes import Homes
from orchestrator.folders import explain, locked
from orchestrator.lanes import Lane
from orchestrator.names import known_names
from orchestrator.plan import find_suite
from orchestrator.sources import PolicySource
from policies import catalog as policies
from policies.contract import PolicyError
from policies.mergevla.card import digest_of
from policies.mergevla.merged_policy import EXPERTS_NAME, expert_folders
from policies.oracles import digest_of_task
from policies.training.writing import DatasetWriter
from policies.zoo import shipped
from results.run import RunStatus
from suites.loading import load_suite
from suites.plugins import nearest
from suites.schema import expand_tasks
from suites.vocabulary import CAMERAS, Cell, Protocol, RenderProfile, View, content_hash

if TYPE_CHECKING:
    from orchestrator.gathering import Listener

ORACLE = "oracle"
FIRST_SEED = 1_000_000
"""Suites count their seeds from 0, so training never sees what is evaluated."""
NOISE = 0.1
DEFAULT_VIEW = View(CAMERAS, 96, RenderProfile.FAST)


class DemonstrateError(Exception):
    """What was asked for cannot be; one line per problem."""


@dataclass(frozen=True)
class Order:
    """What to collect."""

    tasks: tuple[str, ...]
    episodes: int
    """Successful episodes per task."""
    view: View = DEFAULT_VIEW
    noise: float = NOISE
    """Deviation of the executed motion per axis, as a share of the largest motion in one step."""
    first_seed: int = FIRST_SEED
    workers: int = 2
    learner: str | None = None
    """Folder of experts, each of which acts first in its task's episodes, or None: the oracle alone."""
    whole: bool = False
    """Whether what the oracle would do while a learner acts is recorded too."""

    @property
    def learners(self) -> dict[str, Path]:
        """Task to the checkpoint of the expert that acts first.

        Raises:
            PolicyError: The folder holds no experts.
        """
        return expert_folders(shipped(self.learner)) if self.learner is not None else {}

    @property
    def learner_source(self) -> PolicySource | None:
        """From what the learner is built."""
        return PolicySource(EXPERTS_NAME, {"folder": self.learner}) if self.learner is not None else None

    def problems(self) -> list[str]:
        """What is wrong with it, a line each."""
        known = known_names().tasks
        can = playable(self.tasks)
        found = [f"unknown task '{task}'{nearest(task, known)}" for task in self.tasks if task not in known]
        found += [f"the oracle has no script for '{task}'" for task in self.tasks if task in known and task not in can]
        try:
            found += [f"the learner has no expert for '{task}'" for task in can - self.learners.keys() if self.learner]
        except PolicyError as error:
            found.append(f"learner: {error}")
        if self.whole and self.learner is None:
            found.append("whole: expected a learner whose part of the episode is to be recorded, got none")
        if not self.tasks:
            found.append("expected at least one task, got none")
        for name, value, low, high in (
            ("episodes", self.episodes, 1, 100_000),
            ("noise", self.noise, 0, 1),
            ("first seed", self.first_seed, 0, 2**62),
            ("workers", self.workers, 1, 256),
            ("image size", self.view.image_size, 16, 1024),
        ):
            if not low <= value <= high:
                found.append(f"{name}: expected {low} to {high}, got {value:g}")
        wrong = [camera for camera in self.view.cameras if camera not in CAMERAS]
        if wrong or not self.view.cameras:
            found.append(f"camera: expected {' or '.join(CAMERAS)}, got {wrong[0] if wrong else 'none'}")
        return found


@dataclass
class Collected:
    """How a collection ended."""

    status: RunStatus
    lanes: list[Lane]
    seconds: float
    troubles: list[str] = field(default_factory=list)
    """What the user should know, a line each."""


def playable(tasks: Sequence[str]) -> set[str]:
    """Those of the tasks that the oracle can play."""
    can = policies.find(ORACLE).tasks
    return set(tasks) & can() if can else set(tasks)


def resolve(names: Sequence[str]) -> tuple[tuple[str, ...], View]:
    """Tasks and view that suites, tasks and patterns of tasks (`pybullet/*`) stand for.

    The view is the first suite's, so that training sees what evaluation shows; without a suite, `DEFAULT_VIEW`.

    Raises:
        SuiteError: A suite file is wrong.
    """
    known = known_names()
    tasks: list[str] = []
    view = None
    for name in names:
        if name in known.tasks or ("*" in name and not Path(name).exists()):
            tasks += expand_tasks([name], known.tasks) or [name]
            continue
        if name.partition("/")[0] in known.simulators and not Path(name).exists():
            tasks.append(name)
            continue
        suite = load_suite(find_suite(name), known)
        tasks += suite.tasks
        view = view or View(suite.cameras, suite.image_size, suite.render_profile)
    return tuple(dict.fromkeys(tasks)), view or DEFAULT_VIEW


def collect(order: Order, folder: Path, listener: Listener) -> Collected:
    """Collect what is missing, a dataset per task under `folder`.

    An interruption or a full disk ends it early: what was committed is kept, and collecting again continues. The data
    depend on the order alone, not on the number of workers, their speed, or interruptions.

    Raises:
        DemonstrateError: The order is wrong, or no simulator of it is installed.
        DatasetError: The folder holds something else.
        FolderError: It cannot be written, or another process collects into it.
    """
    problems = order.problems()
    if problems:
        raise DemonstrateError("\n".join(problems))
    names = dict.fromkeys(task.partition("/")[0] for task in order.tasks)
    homes = Homes()
    absent = {name: reason for name in names if (reason := homes.missing_reason(simulators.find(name)))}
    if len(absent) == len(names):
        raise DemonstrateError("\n".join(f"{name}: {reason}" for name, reason in absent.items()))
    began = time.monotonic()
    with locked(folder):
        lanes = [_lane(task, order, folder, homes) for task in order.tasks]
        for lane in lanes:
            if lane.simulator in absent:
                lane.give_up(absent[lane.simulator])
        collected = Collected(RunStatus.COMPLETE, lanes, 0.0)
        _play(order, collected, listener, homes)
        for lane in lanes:
            if lane.reason:
                collected.troubles.append(f"{lane.task}: {lane.reason}")
        if collected.status is RunStatus.COMPLETE and any(lane.kept < lane.episodes for lane in lanes):
            collected.status = RunStatus.STOPPED
    collected.seconds = time.monotonic() - began
    return collected


def _play(order: Order, collected: Collected, listener: Listener, homes: Homes) -> None:
    from orchestrator.gathering import Gatherer

    lanes = collected.lanes
    if not any(lane.open for lane in lanes):
        return
    try:
        try:
            with ray_session(address=None, workers=order.workers):
                Gatherer(lanes, order.noise, order.workers, listener, order.learner_source, order.whole, homes).run()
        finally:
            for lane in lanes:
                lane.flush()
    except KeyboardInterrupt:
        collected.status = RunStatus.INTERRUPTED
    except (OSError, RayLost) as error:
        collected.status = RunStatus.STOPPED
        collected.troubles.append(explain(error))


def _lane(task: str, order: Order, folder: Path, homes: Homes) -> Lane:
    """A task's lane, with what is there already."""
    card = simulators.task_cards()[task]
    made_by: dict[str, Any] = {"oracle": digest_of_task(task), "noise": order.noise}
    horizon = card.horizon
    if learner := order.learners.get(task):
        made_by["learner"] = digest_of(str(learner))
        if order.whole:
            made_by["whole"] = True
        horizon *= 2  # as much for the oracle as without the learner
    cell = Cell(ORACLE, content_hash(made_by), task, Protocol(horizon, 1, order.view))
    source = {
        "task": task,
        **made_by,
        "first_seed": order.first_seed,
        "protocol": asdict(cell.protocol),
        "versions": homes.versions(simulators.find(cell.simulator)),
    }
    writer = DatasetWriter(folder / dataset_name(task), source)
    return Lane(cell, order.episodes, order.first_seed, writer)


def dataset_name(task: str) -> str:
    """Folder of a task's dataset."""
    return task.replace("/", "__")


def folder_size(folder: Path) -> int:
    """Bytes of the files below a folder."""
    return sum(os.path.getsize(path) for path in folder.rglob("*") if path.is_file())  # noqa: PTH202
