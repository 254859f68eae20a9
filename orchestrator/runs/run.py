"""Runs a suite: creates or continues the run, plays missing episodes, records media, writes the report."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from robogauntlet.orchestrator.episodes.policy_source import PolicySource, with_bundles
from robogauntlet.orchestrator.ray_runtime.session import NoRoom, RayLost, ray_session, room_for_workers
from robogauntlet.orchestrator.replay.media_selection import condition_snapshots
from robogauntlet.orchestrator.runs.history_writer import HistoryWriter
from robogauntlet.orchestrator.runs.plan import Plan, remaining_work
from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.orchestrator.runs.run_document import create_or_continue
from robogauntlet.orchestrator.runs.run_observer import RunObserver
from robogauntlet.policies.contract import PolicyError
from robogauntlet.results.folder_lock import FolderError, lock_folder
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import RUN_FILE, RunDocument, RunStatus, store_url, write_run
from robogauntlet.results.store.database import without_password
from robogauntlet.results.store.episode_store import Store, StoreError
from robogauntlet.suites.episode import Cell
from robogauntlet.support.errors import describe_os_error

if TYPE_CHECKING:
    from robogauntlet.results.report import Report

RAY_STARTS = 5
"""Number of Ray sessions of a run, each started after the previous one died, before the run stops."""
SAVE_ELAPSED_S = 10.0
"""Time after which the elapsed time is saved again (s)."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run that are not part of the suite."""

    store: str | None = None
    """URL of the store, or None for a file in the run folder."""
    address: str | None = None
    """Ray cluster to join, or None for this machine."""
    retry_errors: bool = False
    """Play episodes again whose row is an error."""
    media: bool = True
    """Afterwards record videos (a success and a failure per policy and task, failures along axes) and snapshots."""
    history: str | None = None
    """URL of the history of all runs; by default the run is recorded in its own store only."""
    schedule: str | None = None
    """The schedule that starts this run, if any."""


@dataclass
class RunOutcome:
    """The outcome of a run."""

    folder: Path
    document: RunDocument
    done: int
    """Rows in the store."""
    report: Report | None
    """None if it could not be written."""
    warnings: list[str] = field(default_factory=list)
    """Messages for the user, a line each."""


def run_plan(plan: Plan, folder: Path, options: RunOptions, progress: Progress) -> RunOutcome:
    """Play the missing episodes of a plan and write all results into `folder`.

    An interruption, a full disk or too many errors end the run early. The returned rows are kept, the outcome has the
    status and the reason, and running again continues.

    Raises:
        PlanError: The folder holds another run.
        FolderError: The folder cannot be written, or another process writes into it.
        RunError: The folder's document cannot be read, or its rows are in a database whose URL was not given.
        StoreError: The store cannot be opened.
    """
    with lock_folder(folder, for_run=True), contextlib.ExitStack() as stack:
        session = RunSession(plan, folder, options, progress, stack)
        session.play()
        return session.finish()


class RunSession:
    """One process's work on a run."""

    def __init__(
        self, plan: Plan, folder: Path, options: RunOptions, progress: Progress, stack: contextlib.ExitStack
    ) -> None:
        """Create or continue the run; `stack` closes its stores."""
        self._plan, self._folder, self._options, self._progress = plan, folder, options, progress
        continued, url = (folder / RUN_FILE).exists(), options.store
        self._document = document = create_or_continue(plan, folder, url)
        if continued and url is not None and without_password(url) != document.store_url:
            self._store = Store.open_begun(folder, document, url)  # another store, which must contain the run's rows
        else:
            self._store = Store.open(store_url(folder, document, url), document.run_id)
        stack.callback(self._store.close)
        try:
            write_run(folder, document)
        except OSError as error:
            raise FolderError(f"{folder}: {describe_os_error(error)}") from None
        self._history_writer = HistoryWriter(folder, self._store, options.history or url, options.schedule)
        stack.callback(self._history_writer.close)
        self._history_writer.record(document, counted=False)
        if options.retry_errors:
            self._store.forget_errors()
        self._observer = RunObserver(document, plan.unavailable, progress, self._history_writer, self._save_elapsed)
        self._status = RunStatus.COMPLETE
        self._reason: str | None = None
        self._began = self._saved = time.monotonic()

    def play(self) -> None:
        """Play missing episodes and record media. Errors that a run survives become its status."""
        from robogauntlet.orchestrator.scheduling.scheduler import TooManyErrors
        from robogauntlet.orchestrator.scheduling.worker_pool import WorkerPoolError

        self._progress.begin(self._plan, self._store.status_counts())
        try:
            self._play_through_ray_restarts()
        except KeyboardInterrupt:
            self._status, self._reason = RunStatus.INTERRUPTED, "stopped from outside"
        except (TooManyErrors, NoRoom, RayLost, WorkerPoolError, PolicyError, StoreError, OSError) as error:
            self._status, self._reason = RunStatus.STOPPED, str(error)

    def _play_through_ray_restarts(self) -> None:
        for starts_left in reversed(range(RAY_STARTS)):
            try:
                work = self._remaining_work()
                if work:
                    self._play(work)
                else:
                    self._record_media(self._sources)  # an earlier session may have ended before
                return
            except RayLost as error:
                if not starts_left:
                    raise
                self._observer.on_warning(f"{error}; it was started again")

    def _play(self, work: list[tuple[Cell, Sequence[int]]]) -> None:
        """Play this work and all further rounds of an adaptive suite, then record media. Raises as `Scheduler.run`."""
        from robogauntlet.orchestrator.inference.ray_policy_server import choose_inference, start_servers
        from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
        from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
        from robogauntlet.orchestrator.scheduling.work_queue import work_queues

        suite, per_simulator = self._plan.suite, self._document.workers
        scheduling = SchedulerOptions(
            workers=per_simulator or room_for_workers,
            episode_time_limit_s=suite.episode_time_limit_s,
            allowed_errors=int(suite.error_tolerance * self._plan.episodes),
            resources=suite.resources,
        )
        fixed = sum(per_simulator.get(name, 0) for name in {cell.simulator for cell, _ in work})
        with ray_session(address=self._options.address, workers=fixed):
            workers = fixed or room_for_workers()
            sources = self._sources()
            place = choose_inference(sources, self._plan.cells, suite.inference, workers, self._progress.log)
            self._update(inference=place, shared_workers=None if per_simulator else workers)
            servers = start_servers(sources, suite.inference) if place == "served" else []
            with self._progress:
                while work:
                    pool = RayWorkerPool(sources, suite.resources, servers, self._plan.environments)
                    queues = work_queues(work, suite.max_attempts)
                    Scheduler(queues, pool, scheduling, sink=self._store.add, observer=self._observer).run()
                    before, work = work, self._remaining_work() if suite.adaptive else []
                    if work == before:  # the remaining episodes cannot be played here
                        break
            self._record_media(lambda: sources)

    def _sources(self) -> Mapping[str, PolicySource]:
        """The policies, with bundles of their files for the nodes of a cluster. Ray must be running."""
        return self._plan.sources if self._options.address is None else with_bundles(self._plan.sources)

    def _remaining_work(self) -> list[tuple[Cell, Sequence[int]]]:
        """The remaining work; for an adaptive suite, of the current round."""
        state = remaining_work(self._plan, self._store.outcomes(), self._observer.skipped_simulators)
        self._update(plan=self._plan.planned_cells(state.planned), decided=tuple(state.decided))
        return state.work

    def _record_media(self, sources: Callable[[], Mapping[str, PolicySource]]) -> None:
        """Record missing videos and snapshots; errors become warnings, except RayLost."""
        from robogauntlet.orchestrator.replay.media import pending_media, record_media

        if not self._options.media:
            return
        plan, observer, seed = self._plan, self._observer, self._plan.suite.seeds.start
        baselines = (plan.suite.oracle_gate, *plan.suite.no_skill_baselines)
        evaluated, skipped = [name for name in plan.sources if name not in baselines], observer.skipped_simulators
        snapshots = condition_snapshots((cell for cell in plan.cells if cell.simulator not in skipped), seed)
        try:
            pending = pending_media(self._folder, self._store.results, evaluated, snapshots)
            pending = [item for item in pending if item.simulator not in skipped]
            if not pending:
                return
            self._progress.log(
                "recording a success and a failure of each policy on each task"
                + (", failures along each axis, and the first images of each condition" if snapshots else "")
            )
            with (
                ray_session(address=self._options.address, workers=len({item.simulator for item in pending})),
                self._progress.recording(len(pending)) as bar,
            ):

                def on_recorded() -> None:
                    bar.advance()
                    observer.on_media_tick()

                observer.warnings += record_media(self._folder, pending, sources(), on_recorded, plan.environments)
        except (OSError, StoreError) as error:
            observer.warnings.append(f"videos could not be written: {describe_os_error(error)}")

    def finish(self) -> RunOutcome:
        """Write the document and the report."""
        from robogauntlet.results.report import write_report

        done, digest = 0, None
        with contextlib.suppress(StoreError):
            done = sum(self._store.status_counts().values())
            digest = rows_hash(map(outcome_row, self._store.results()))
        missing = self._document.planned - done
        if self._status is RunStatus.COMPLETE and missing > 0 and not self._observer.skipped_simulators:
            self._status, self._reason = RunStatus.STOPPED, f"{missing} episodes are missing"
        self._update(
            status=self._status,
            reason=self._reason,
            finished_at=time.time(),
            elapsed_s=self._elapsed_s(),
            skipped=self._observer.skipped_simulators,
            render_devices=self._observer.render_devices,
            rows_hash=digest,
        )
        report, warnings = None, self._observer.warnings
        try:
            write_run(self._folder, self._document)
            self._history_writer.record(self._document)
            report = write_report(self._folder, store_url=self._options.store)
        except (OSError, StoreError) as error:
            remedy = f"write it later: robogauntlet report {self._folder}"
            warnings.append(f"the report could not be written: {describe_os_error(error)}; {remedy}")
        return RunOutcome(self._folder, self._document, done, report, warnings + self._history_writer.warnings)

    def _update(self, **values: object) -> None:
        self._document = self._document.model_copy(update=values)

    def _elapsed_s(self) -> float:
        """Total time of all sessions so far (s)."""
        return self._document.elapsed_s + time.monotonic() - self._began

    def _save_elapsed(self) -> None:
        """Save the elapsed time every `SAVE_ELAPSED_S`, because a killed session cannot save it at its end."""
        if time.monotonic() - self._saved >= SAVE_ELAPSED_S:
            self._saved = time.monotonic()
            with contextlib.suppress(OSError):  # the store will notice a full disk
                write_run(self._folder, self._document.model_copy(update={"elapsed_s": self._elapsed_s()}))
