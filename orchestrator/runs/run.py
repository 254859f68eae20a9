"""Runs a suite: creates or continues the run, plays missing episodes, writes the report, then records media."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from robogauntlet.orchestrator.episodes.policy_source import PolicySource, with_bundles
from robogauntlet.orchestrator.ray_runtime.cluster import NoCluster
from robogauntlet.orchestrator.ray_runtime.session import (
    NoRoom,
    RayLost,
    import_ray,
    ray_session,
    room_for_workers,
)
from robogauntlet.orchestrator.replay.media_selection import condition_snapshots, first_failures, shared_by
from robogauntlet.orchestrator.runs.adaptive_stopping import Outcomes, Progression
from robogauntlet.orchestrator.runs.plan import Plan, remaining_work
from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.orchestrator.runs.run_document import create_or_continue
from robogauntlet.orchestrator.runs.run_observer import RunObserver
from robogauntlet.orchestrator.runs.run_place import RunPlace
from robogauntlet.orchestrator.runs.run_tracking import RunTracking
from robogauntlet.orchestrator.trackers.live_tracker import LiveTracker
from robogauntlet.policies.contract import PolicyError
from robogauntlet.results.folder_lock import lock_folder
from robogauntlet.results.record import EpisodeResult, Status, outcome_row, rows_hash
from robogauntlet.results.run_document import RunDocument, RunStatus, shortened, write_run
from robogauntlet.results.store.episode_store import StoreError, check_place
from robogauntlet.suites.episode import Cell
from robogauntlet.support.durations import format_duration
from robogauntlet.support.errors import describe_os_error, first_line
from robogauntlet.support.text import counted

if TYPE_CHECKING:
    from robogauntlet.orchestrator.replay.media_selection import Snapshot
    from robogauntlet.results.report import Report

RAY_STARTS = 5
"""Number of Ray sessions of a run, each started after the previous one died, before the run stops."""
SAVE_ELAPSED_S = 10.0
"""Time after which the elapsed time is saved again (s)."""
MEDIA_SHARE = 0.2
"""Largest time for videos and snapshots, as a share of the time that the episodes took."""
FIRST_FAILURES_S = 60.0
"""Time that a failure of each policy may take, however short the episodes were (s)."""
Returned = TypeVar("Returned")
Rounds = Callable[[Sequence[Cell], Outcomes], Progression]
"""Chooses the episodes of the next round among cells that can be played, from the outcomes so far."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run that are not part of the suite."""

    store: str | None = None
    """URL of the store, or None for a file in the run folder."""
    address: str | None = None
    """Ray cluster to join, or None for this machine."""
    retry_errors: bool = False
    """Play episodes again whose row is an error."""
    media: bool | None = None
    """Afterwards record videos (a success and a failure per policy and task, failures along axes) and snapshots: all,
    none, or by default what fits into `MEDIA_SHARE`."""
    history: str | None = None
    """URL of the history of all runs; by default the run is recorded in its own store only."""
    schedule: str | None = None
    """The schedule that starts this run, if any."""
    command: str | None = None
    """The command that continues this run."""


@dataclass
class RunOutcome:
    """The outcome of a run."""

    folder: Path
    document: RunDocument
    done: int | None
    """Rows in the store; None if it cannot be read."""
    report: Report | None
    """None if it could not be written."""
    warnings: list[str] = field(default_factory=list)
    """Messages for the user, a line each."""
    media_interrupted: bool = False
    """Whether the recording of videos was interrupted, after everything else was complete."""
    logged: str | None = None
    """Where the run is in the experiment tracker, if all of it was sent to one."""


def run_plan(
    plan: Plan,
    folder: Path,
    options: RunOptions,
    progress: Progress,
    on_numbers: Callable[[RunOutcome], None] = lambda outcome: None,
    tracker: LiveTracker | None = None,
    rounds: Rounds | None = None,
) -> RunOutcome:
    """Play the missing episodes of a plan and write all results into `folder`.

    The report is written and `on_numbers` called when the last episode has ended; then videos and snapshots are
    recorded, and the report is written again with them. An interruption, a full disk or too many errors end the run
    early. The returned rows are kept, the outcome has the status and the reason, and running again continues. An
    experiment `tracker` receives the progress, the results and the videos, and is closed. With `rounds`, only the
    episodes that it chooses are played, until it chooses none.

    Raises:
        PlanError: The folder holds another run.
        FolderError: The folder cannot be written, or another process writes into it.
        RunError: The folder's document cannot be read, or its rows are in a database whose URL was not given.
        StoreError: The store cannot be opened.
    """
    for url in filter(None, (options.store, options.history)):
        check_place(folder, url)
    with tracker or contextlib.nullcontext(), lock_folder(folder, for_run=True), contextlib.ExitStack() as stack:
        session = RunSession(plan, folder, options, progress, stack, tracker, rounds)
        session.play()
        outcome = session.conclude()
        on_numbers(outcome)
        return session.finish_tracking(session.record_media(outcome))


class RunSession:
    """One process's work on a run."""

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        options: RunOptions,
        progress: Progress,
        stack: contextlib.ExitStack,
        tracker: LiveTracker | None,
        rounds: Rounds | None = None,
    ) -> None:
        """Create or continue the run; `stack` closes its stores and ends Ray."""
        self._plan, self._options, self._progress = plan, options, progress
        self._rounds = rounds
        self._ray = stack.enter_context(contextlib.ExitStack())
        document = create_or_continue(plan, folder, options.store).model_copy(update={"command": options.command})
        self._document = document
        self._place = RunPlace(plan, folder, document, options.store)
        stack.callback(lambda: self._place.store.close())
        self._history_writer = self._place.open_history(options.history, options.schedule)
        stack.callback(lambda: self._history_writer.close())
        self._history_writer.record(document, counted=False)
        if options.retry_errors:
            self._place.store.forget_errors()
        self._tracking = RunTracking(tracker, document, folder, self._place.store, progress)
        self._observer = RunObserver(
            document, plan.unavailable, progress, self._history_writer, self._tracking, self._save_elapsed
        )
        self._observer.warnings.extend([*plan.warnings, *self._place.warnings])
        self._start_s: dict[str, float] = {}
        """Simulator to the time that its latest worker took from its start to its first result."""
        self._status = RunStatus.COMPLETE
        self._reason: str | None = None
        self._phase = "elapsed_s"
        self._began = self._saved = time.monotonic()

    def _stay_saved(self) -> None:
        """Continue beside the run's place if that is lost. Raises as `RunPlace.save_beside`."""
        if self._place.is_lost:
            self._document = self._place.save_beside(self._document)
            self._status, self._reason = RunStatus.STOPPED, self._document.reason
            self._history_writer.close()
            self._history_writer = self._place.open_history(self._options.history, self._options.schedule)

    def play(self) -> None:
        """Play missing episodes. Errors that a run survives become its status."""
        from robogauntlet.orchestrator.scheduling.scheduler import TooManyErrors
        from robogauntlet.orchestrator.scheduling.worker_pool import WorkerPoolError

        self._progress.begin(self._plan, self._place.store.status_counts())
        try:
            self._through_ray_restarts(self._play_missing)
        except KeyboardInterrupt:
            self._status, self._reason = RunStatus.INTERRUPTED, "stopped from outside"
        except (TooManyErrors, NoCluster, NoRoom, RayLost, WorkerPoolError, PolicyError, StoreError, OSError) as error:
            self._status, self._reason = RunStatus.STOPPED, str(error)

    def _through_ray_restarts(self, step: Callable[[], Returned]) -> Returned:
        for _ in range(RAY_STARTS - 1):
            try:
                return step()
            except RayLost as error:
                self._ray.close()
                again = "it was started again" if self._options.address is None else "joining it again"
                self._observer.on_warning(f"{error}; {again}")
        return step()

    def _play_missing(self) -> None:
        if work := self._remaining_work():
            self._play(work)

    def _play(self, work: list[tuple[Cell, Sequence[int]]]) -> None:
        """Play this work and all further rounds. Raises as `Scheduler.run`."""
        import_ray()
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
        self._ray.enter_context(ray_session(address=self._options.address, workers=fixed))
        workers = fixed or room_for_workers()
        sources = self._sources()
        place = choose_inference(sources, self._plan.cells, suite.inference, workers, self._progress.log)
        self._update(inference=place, shared_workers=None if per_simulator else workers)
        servers = start_servers(sources, suite.inference) if place == "served" else []
        with self._progress:
            while work:
                pool = RayWorkerPool(sources, suite.resources, servers, self._plan.environments)
                queues = work_queues(work, suite.max_attempts)
                sink, start_s = self._place.add, self._start_s
                Scheduler(queues, pool, scheduling, sink=sink, observer=self._observer, start_s=start_s).run()
                before, work = work, self._remaining_work() if suite.adaptive or self._rounds else []
                if work == before:  # the remaining episodes cannot be played here
                    break

    def _sources(self) -> Mapping[str, PolicySource]:
        """The policies, with bundles of their files for the nodes of a cluster. Ray must be running."""
        return self._plan.sources if self._options.address is None else with_bundles(self._plan.sources)

    def _remaining_work(self) -> list[tuple[Cell, Sequence[int]]]:
        """The remaining work; if there are rounds, of the current one."""
        outcomes, skipped = self._place.store.outcomes(), self._observer.skipped_simulators
        if self._rounds is None:
            state = remaining_work(self._plan, outcomes, skipped)
        else:
            state = self._rounds([cell for cell in self._plan.cells if cell.simulator not in skipped], outcomes)
            self._progress.replan(state.planned)
        self._update(plan=self._plan.planned_cells(state.planned), decided=tuple(state.decided))
        return state.work

    def conclude(self) -> RunOutcome:
        """Write the document and the report of what was played."""
        done, digest, played = None, None, True
        try:
            self._stay_saved()
            counts = self._place.store.status_counts()
            done, played = sum(counts.values()), any(status != Status.ERROR for _, status in counts)
            digest = rows_hash(map(outcome_row, self._place.store.results()))
        except (OSError, StoreError) as error:
            if self._status is RunStatus.COMPLETE:
                self._status, self._reason = RunStatus.STOPPED, first_line(describe_os_error(error))
        missing = 0 if done is None else self._document.planned - done
        if self._status is RunStatus.COMPLETE and missing > 0 and not self._observer.skipped_simulators:
            self._status, self._reason = RunStatus.STOPPED, f"{counted(missing, 'episode')} missing"
        if self._status is RunStatus.COMPLETE and not played:
            self._status, self._reason = RunStatus.STOPPED, self._why_nothing()
        self._update(
            status=self._status,
            reason=None if self._reason is None else shortened(self._reason),
            finished_at=time.time(),
            skipped=self._observer.skipped_simulators,
            render_devices=self._observer.render_devices,
            rows_hash=digest,
            **self._elapsed(),
        )
        outcome = self._write(done)
        self._tracking.conclude(outcome.document, outcome.report.tables if outcome.report else None)
        return outcome

    def _why_nothing(self) -> str:
        """Why no episode was played, in a line."""
        skipped = self._observer.skipped_simulators
        reasons = [f"{name} is skipped: {first_line(reason)}" for name, reason in skipped.items()]
        return f"no episode was played; {'; '.join(reasons) or 'each ended in an error'}"

    def finish_tracking(self, outcome: RunOutcome) -> RunOutcome:
        """Send the videos to the experiment tracker, and wait a moment until it has everything."""
        logged, warnings = self._tracking.finish(self._place.store.results)
        return replace(outcome, logged=logged, warnings=outcome.warnings + warnings)

    def record_media(self, concluded: RunOutcome) -> RunOutcome:
        """Record missing videos and snapshots of a complete run and write the report again. Errors become warnings."""
        if concluded.document.status is not RunStatus.COMPLETE or self._options.media is False:
            return concluded
        self._phase, self._began = "media_s", time.monotonic()
        self._left_out, interrupted = 0, False
        try:
            if not self._through_ray_restarts(self._record_media) and not self._document.media_left_out:
                return concluded
        except KeyboardInterrupt:
            interrupted = True
        except (NoCluster, RayLost, OSError, StoreError) as error:
            self._observer.warnings.append(f"videos could not be recorded: {describe_os_error(error)}")
        self._update(media_left_out=self._left_out, finished_at=time.time(), **self._elapsed())
        return replace(self._write(concluded.done), media_interrupted=interrupted)

    def _pending_media(self) -> list[Snapshot | EpisodeResult]:
        from robogauntlet.orchestrator.replay.media import pending_media
        from robogauntlet.results.analysis.combinations import cluster_failures

        plan, skipped, evaluated = self._plan, self._observer.skipped_simulators, self._evaluated()
        snapshots = condition_snapshots(plan.cells, plan.suite.seeds.start)
        in_clusters = cluster_failures(self._document, self._place.store.results)
        pending = pending_media(self._place.folder, self._place.store.results, evaluated, snapshots, in_clusters)
        return [item for item in pending if item.simulator not in skipped]

    def _evaluated(self) -> list[str]:
        references = self._plan.suite.reference_policies
        return [name for name in self._plan.sources if name not in references]

    def _record_media(self) -> bool:
        """Record missing videos and snapshots, as many as their time allows. Returns whether any were missing."""
        missing = self._pending_media()
        self._left_out = total = len(missing)
        share_s = math.inf if self._options.media else MEDIA_SHARE * self._document.elapsed_s
        attempted, end = False, self._began + share_s - self._document.media_s
        if share_s < FIRST_FAILURES_S and self._document.media_s == 0.0:
            evaluated = self._evaluated()
            shown = {shared_by(row) for row in first_failures(self._place.store.results(), evaluated)}
            first = [item for item in missing if isinstance(item, EpisodeResult) and shared_by(item) in shown]
            attempted = self._record(first, self._began + FIRST_FAILURES_S)
            missing = [item for item in missing if item not in first]
        attempted = self._record(missing, end) or attempted
        if attempted:
            taken = format_duration(time.monotonic() - self._began)
            recorded = counted(total - self._left_out, "video or snapshot", "videos and snapshots")
            self._progress.log(f"recorded {recorded} in {taken}")
        return total > 0

    def _record(self, missing: Sequence[Snapshot | EpisodeResult], end: float) -> bool:
        """Record these until `end`, by the clock. Returns whether there was time for any."""
        from robogauntlet.orchestrator.replay.media import record_media

        left_s = end - time.monotonic()
        pending = [item for item in missing if self._start_s.get(item.simulator, 0.0) < left_s]
        if not pending:
            return False
        limit = f", for at most {format_duration(left_s)}" if left_s < math.inf else ""
        self._progress.log(f"recording {counted(len(pending), 'video or snapshot', 'videos and snapshots')}{limit}")
        with self._progress.recording(len(pending), end) as bar:

            def on_recorded(warning: str | None) -> None:
                self._left_out -= warning is None
                if warning is not None and warning not in self._observer.warnings:
                    self._observer.warnings.append(warning)
                bar.advance()
                self._observer.on_media_tick()

            self._ray.enter_context(ray_session(address=self._options.address, workers=0))
            left_s, environments = end - time.monotonic(), self._plan.environments
            record_media(self._place.folder, pending, self._sources(), on_recorded, environments, left_s)
        return True

    def _write(self, done: int | None) -> RunOutcome:
        """Write the document, and the report unless the run was interrupted before its first row.

        A complete run whose report could not be written is a stopped one.
        """
        report, warnings = None, self._observer.warnings
        try:
            self._stay_saved()
            write_run(self._place.folder, self._document)
            self._history_writer.record(self._document)
            if done != 0 or self._document.status is not RunStatus.INTERRUPTED:  # Ctrl-C at the start ends soon
                from robogauntlet.results.report import write_report

                report = write_report(self._place.folder, store_url=self._place.url)
        except (OSError, StoreError) as error:
            reason = f"the report could not be written: {describe_os_error(error)}"
            warnings.append(f"{reason}; write it later: robogauntlet report {self._place.folder}")
            if self._document.status is RunStatus.COMPLETE:
                self._update(status=RunStatus.STOPPED, reason=shortened(reason))
        return RunOutcome(self._place.folder, self._document, done, report, warnings + self._history_writer.warnings)

    def _update(self, **values: object) -> None:
        self._document = self._document.model_copy(update=values)

    def _elapsed(self) -> dict[str, float]:
        """The time that the phase took so far, over all sessions (s), by its field in the document."""
        return {self._phase: getattr(self._document, self._phase) + time.monotonic() - self._began}

    def _save_elapsed(self) -> None:
        """Save the elapsed time every `SAVE_ELAPSED_S`, because a killed session cannot save it at its end."""
        if time.monotonic() - self._saved >= SAVE_ELAPSED_S and not self._place.is_lost:
            self._saved = time.monotonic()
            with contextlib.suppress(OSError):  # the store will notice a full disk, and a lost folder
                write_run(self._place.folder, self._document.model_copy(update=self._elapsed()))
