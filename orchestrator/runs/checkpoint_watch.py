"""Evaluates the checkpoints of a training while it trains, each in a run of its own, the newest first."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from rich.console import Console

from robogauntlet.orchestrator.registry import find_suite, load_registry
from robogauntlet.orchestrator.runs.checkpoint_folder import (
    CHECKPOINTS,
    Checkpoint,
    ReadyCheckpoints,
    find_checkpoints,
    state_of,
    step_of,
    training_folder,
    written_at,
)
from robogauntlet.orchestrator.runs.composition import SUITE_FILE
from robogauntlet.orchestrator.runs.history_observer import HistoryObserver
from robogauntlet.orchestrator.runs.observer import RunState
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.progress_display import ProgressDisplay
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.orchestrator.runs.suite_names import add_policies
from robogauntlet.policies import catalog, python_policy
from robogauntlet.policies.references import read_reference, with_options
from robogauntlet.results.analysis.comparison import RunComparison
from robogauntlet.results.analysis.learning_curve import COLUMNS, CurvePoint, LearningCurve, curve_point, learning_curve
from robogauntlet.results.api import compare, open_run
from robogauntlet.results.folder_lock import FolderError
from robogauntlet.results.run_document import RUN_FILE, RunError, RunStatus, read_run
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.run_history import history_url
from robogauntlet.suites.loading import SuiteError, load_suite
from robogauntlet.suites.schema import PolicyEntry, Suite, valid_name
from robogauntlet.suites.selection import SuiteSelection
from robogauntlet.support.errors import BadInput, UserError, first_line
from robogauntlet.support.text import counted

POLL_S = 2.0
"""Time between two looks at the folder (s)."""
SETTLE_S = 10.0
"""Time for which the files of a checkpoint stay unchanged before it counts as whole, by default (s)."""
REWRITTEN = "written again after its run began; it keeps its run, choose another folder with --out to play it again"


@dataclass(frozen=True)
class Watched:
    """A training, and how its checkpoints are played."""

    folder: Path
    suite_path: Path
    suite: Suite
    suite_text: str
    kind: str | None
    """What `policy_of` takes."""
    options: Mapping[str, Any]
    policy: str
    """Name of the policy in all runs."""

    @classmethod
    def read(cls, folder: Path, suite: str, kind: str | None, options: Mapping[str, Any]) -> Watched:
        """Read the suite and check everything that does not need a checkpoint.

        Raises:
            BadInput: The folder does not exist, the suite has a single seed or a policy of the training's name, or the
                kind takes no checkpoint.
            SuiteError: The suite is wrong.
        """
        if not folder.is_dir():
            what = "this is a file" if folder.exists() else "it does not exist"
            raise BadInput(f"{folder}: expected the folder into which a training writes its checkpoints, {what}")
        path = find_suite(suite)
        loaded = load_suite(path, load_registry())
        if loaded.seeds.count < 2:
            raise BadInput(
                f"{path}: expected 2 seeds or more, since even seeds choose the best checkpoint and odd ones measure "
                f"it; got {loaded.seeds.count}"
            )
        root = training_folder(folder)
        name = valid_name(root.parent.name if root.name == CHECKPOINTS else root.name) or "policy"
        entry = (
            PolicyEntry(name=name, kind=python_policy.NAME) if kind is None else policy_of(kind, root, options, name)
        )
        add_policies(loaded, SuiteSelection(added=(entry,)), path)
        return cls(folder, path, loaded, path.read_text(encoding="utf-8"), kind, options, name)


def policy_of(kind: str | None, folder: Path, options: Mapping[str, Any], name: str) -> PolicyEntry:
    """Return the policy of a checkpoint's folder, with these options.

    Args:
        kind: A kind with an option `checkpoint`; `python:MODULE:NAME`, which gets the folder as an argument of that
            name; or None for the kind that knows what is in the folder.
        folder: The folder.
        options: Options of the kind.
        name: Name of the policy.

    Raises:
        BadInput: The kind takes no checkpoint or has no such option, or no kind knows the folder.
    """
    is_lerobot = (folder / "config.json").is_file()
    (entry,) = with_options([read_reference(kind or (f"lerobot:{folder}" if is_lerobot else str(folder)))], options)
    own: dict[str, Any] = {} if kind is None else {"checkpoint": str(folder)}
    if entry.kind == python_policy.NAME:
        arguments = entry.options.get("options", {})
        if not isinstance(arguments, Mapping):
            raise BadInput(f"--option options: expected a mapping of arguments, got {arguments!r}")
        own = {"options": {**arguments, **own}}
    elif own.keys() - catalog.find(entry.kind).options.keys():
        raise BadInput(f"--policy-kind {kind}: expected a kind with an option checkpoint, or python:MODULE:NAME")
    return entry.model_copy(update={"name": name, "options": {**entry.options, **own}})


@dataclass
class CheckpointWatch:
    """Plays the checkpoints of a training into an output folder."""

    watched: Watched
    out: Path
    ready: ReadyCheckpoints
    log: Callable[[str], None]
    """Receives a line about each checkpoint that is not played to its end, and each warning about a run once."""
    console: Console
    command: str
    """The command that goes on."""
    history: str | None = None
    """URL of the history, by default that of the output folder."""
    _points: dict[str, CurvePoint] = field(default_factory=dict)
    _warned: set[str] = field(default_factory=set)

    def continue_runs(self) -> None:
        """Take over the runs that are complete in the output folder.

        Raises:
            BadInput: It has runs of another suite or policy.
            RunError, StoreError: A run cannot be read.
        """
        watched = self.watched
        for file in sorted(self.out.glob(f"*/{RUN_FILE}")):
            folder, document = file.parent, read_run(file.parent)
            policies = {cell.policy for cell in document.plan}
            if document.suite.name != watched.suite.name or watched.policy not in policies:
                raise BadInput(
                    f"{folder}: expected a run of '{watched.policy}' in suite '{watched.suite.name}', got one of "
                    f"'{', '.join(sorted(policies))}' in '{document.suite.name}'; choose another folder with --out"
                )
            if document.suite_text != watched.suite_text:
                raise BadInput(
                    f"{folder}: expected a run of suite '{watched.suite.name}' as it is now in {watched.suite_path}, "
                    "got one of another text of it; choose another folder with --out"
                )
            if document.status is RunStatus.COMPLETE:
                self._take(folder.name)
        for one in find_checkpoints(training_folder(watched.folder)):
            if one.name in self._points and self._is_rewritten(one):
                self.log(f"{one.name}: {REWRITTEN}")

    def evaluations(self, until: int | None, idle_s: float | None) -> Iterator[Checkpoint]:
        """Play each checkpoint that is ready, the newest first, and yield it when its run is complete.

        Ends when `until` runs are complete, or when nothing was written or played for `idle_s` (s).

        Raises:
            KeyboardInterrupt: It was interrupted; the run that played keeps its rows.
        """
        active_at = time.monotonic()
        while until is None or len(self._points) < until:
            if ready := self.ready.look(self._points):
                if self._play(ready[0]):
                    yield ready[0]
                active_at = time.monotonic()
            elif idle_s is not None and time.monotonic() - max(active_at, self.ready.changed_at) >= idle_s:
                return
            else:
                time.sleep(POLL_S)

    @property
    def curve(self) -> LearningCurve:
        """The learning curve of all runs that are complete."""
        return learning_curve(self.watched.policy, self._points.values())

    def comparisons(self, one: Checkpoint) -> list[RunComparison]:
        """Compare a checkpoint with the last one before it, and the next one with it, on the same seeds.

        Raises:
            RunError, StoreError: A run cannot be read.
        """
        names = [point.name for point in self.curve.points]
        place = names.index(one.name)
        pairs = pairwise(names[max(place - 1, 0) : place + 2])
        return [compare(self.out / later, self.out / earlier, only=[self.watched.policy]) for earlier, later in pairs]

    def _take(self, name: str) -> None:
        """Add a complete run to the curve."""
        if (step := step_of(name)) is not None:
            rows = open_run(self.out / name).episodes(COLUMNS)
            self._points[name] = curve_point(name, step, self.watched.policy, rows)

    def _is_rewritten(self, one: Checkpoint) -> bool:
        folder = self.out / one.name
        return (folder / RUN_FILE).exists() and written_at(state_of(one.folder)) > read_run(folder).started_at

    def _play(self, one: Checkpoint) -> bool:
        """Play a checkpoint, or go on with its run. Return whether it is complete."""
        try:
            run = self._run(one)
        except (UserError, FolderError, RunError, StoreError) as error:
            why = error.problems[0].message if isinstance(error, SuiteError) else first_line(error)
            self.ready.refuse(one, f"not played: {why}")
            return False
        for warning in run.warnings:
            if warning not in self._warned:
                self._warned.add(warning)
                self.log(f"{one.name}: {warning}")
        if run.document.status is RunStatus.INTERRUPTED:
            raise KeyboardInterrupt
        if run.document.status is RunStatus.COMPLETE:
            self._take(one.name)
            return True
        kept = f"{run.done or 0:,} of {counted(run.document.planned, 'episode')} are kept in {run.folder}"
        self.ready.refuse(one, f"stopped: {run.document.reason}; {kept}")
        return False

    def _run(self, one: Checkpoint) -> RunState:
        """Play it. Raises as `make_plan` and `run_plan`, and BadInput if its files were written after its run began."""
        if self._is_rewritten(one):
            raise BadInput(REWRITTEN)
        watched, folder = self.watched, self.out / one.name
        entry = policy_of(watched.kind, one.folder, watched.options, watched.policy)
        # Its own copy of the suite: the file may be edited while a training runs for days.
        plan = make_plan(folder / SUITE_FILE, text=watched.suite_text, part=SuiteSelection(added=(entry,)))
        display, url = ProgressDisplay(self.console), history_url(self.history, folder.absolute().parent)
        display.log(f"{one.name}: {counted(plan.episodes, 'episode')} into {folder}")
        options = RunOptions(retry_errors=True, media=False, command=self.command)
        return run_plan(plan, folder, options, [display, HistoryObserver(url, folder)])
