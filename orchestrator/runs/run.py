"""Runs a suite: creates or continues the run, plays missing episodes, writes the report, then records media."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from robogauntlet.orchestrator.episodes.policy_source import PolicySource, with_bundles
from robogauntlet.orchestrator.ray_runtime.cluster import NoCluster
from robogauntlet.orchestrator.ray_runtime.session import NoRoom, RayLost, import_ray, ray_session, room_for_workers
from robogauntlet.orchestrator.replay.media_selection import condition_snapshots
from robogauntlet.orchestrator.runs.adaptive_stopping import Outcomes, Progression
from robogauntlet.orchestrator.runs.observer import RECORDING, Observer, Recording, RunState
from robogauntlet.orchestrator.runs.observers import Observers
from robogauntlet.orchestrator.runs.plan import Plan, remaining_work
from robogauntlet.orchestrator.runs.run_document import create_or_continue
from robogauntlet.orchestrator.runs.run_place import RunPlace
from robogauntlet.orchestrator.runs.run_progress import RunProgress
from robogauntlet.policies.contract import PolicyError
from robogauntlet.results.folder_lock import lock_folder
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import RunArguments, RunStatus, shortened, write_run
from robogauntlet.results.store.episode_store import StoreError, check_place
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.episode import Cell
from robogauntlet.support.durations import format_duration
from robogauntlet.support.errors import describe_os_error, first_line
from robogauntlet.support.text import counted

if TYPE_CHECKING:
    from robogauntlet.orchestrator.replay.media_selection import Snapshot
    from robogauntlet.results.record import EpisodeResult

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
    """Record videos and snapshots: all, none, or by default a few while they are played and what fits `MEDIA_SHARE`."""
    schedule: str | None = None
    """The schedule that starts this run, if any."""
    command: str | None = None
    """The command that continues this run."""
    arguments: RunArguments | None = None
    """What `robogauntlet resume` needs to continue it."""


def run_plan(
    plan: Plan, folder: Path, options: RunOptions, observers: Sequence[Observer] = (), rounds: Rounds | None = None
) -> RunState:
    """Play the missing episodes of a plan, write all results into `folder` and return the outcome.

    The report is written and the observers' `on_numbers` called when the last episode has ended; then further videos
    and snapshots are recorded, and the report is written again. An interruption, a full disk or too many errors end the
    run early; the rows are kept, and running again continues. `rounds` chooses the episodes to play, until none.

    Raises:
        PlanError: The folder holds another run.
        FolderError: The folder cannot be written, or another process writes into it.
        RunError: The folder's document cannot be read, or its rows are in a database whose URL was not given.
        StoreError: The store cannot be opened.
    """
    if options.store is not None:
        check_place(folder, options.store)
    with lock_folder(folder, for_run=True), contextlib.ExitStack() as stack:
        session = RunSession(plan, folder, options, observers, stack, rounds)
        session.play()
        session.conclude()
        session.record_media()
        return session.end()


class RunSession(Observer):
    """One process's work on a run."""

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        options: RunOptions,
        observers: Sequence[Observer],
        stack: contextlib.ExitStack,
        rounds: Rounds | None = None,
    ) -> None:
        """Create or continue the run; `stack` closes its store and its observers, and ends Ray."""
        self._plan, self._options = plan, options
        self._rounds = rounds
        self._ray = stack.enter_context(contextlib.ExitStack())
        document = create_or_continue(plan, folder, options.store)
        document = document.model_copy(update={"command": options.command, "arguments": options.arguments})
        self._place = RunPlace(plan, folder, document, options.store)
        stack.callback(lambda: self._place.store.close())
        self._history.record(document, folder, schedule=options.schedule)
        if options.retry_errors:
            self._place.store.forget_errors()
        stored = self._history.count_cells(document.run_id)
        self._run = RunState(
            plan,
            document,
            folder,
            self._place.store,
            RunProgress(plan, stored),
            is_own=self._place.is_own,
            warnings=[f"{name} is skipped: {reason}" for name, reason in plan.unavailable.items()],
            skipped={name: shortened(why) for name, why in plan.unavailable.items()},
            render_devices=dict(document.render_devices),
        )
        self._run.warnings += [*plan.warnings, *self._place.warnings]
        self._observers = stack.enter_context(Observers([self, *observers], self._run))
        self._already = sum(counts.done for counts in stored.values())
        self._start_s: dict[str, float] = {}
        """Simulator to the time that its latest worker took from its start to its first result."""
        self._status = RunStatus.COMPLETE
        self._reason: str | None = None
        self._phase = "elapsed_s"
        self._began = self._saved = time.monotonic()

    @property
    def _history(self) -> History:
        """The entry of the run in its own store."""
        return History(self._place.store.database)

    def _stay_saved(self) -> None:
        """Continue beside the run's place if that is lost. Raises as `RunPlace.save_beside`."""
        if self._place.is_lost:
            run = self._run
            run.document = self._place.save_beside(run.document)
            run.folder, run.store = self._place.folder, self._place.store
            self._status, self._reason = RunStatus.STOPPED, run.document.reason

    def play(self) -> None:
        """Play missing episodes. Errors that a run survives become its status."""
        from robogauntlet.orchestrator.scheduling.scheduler import TooManyErrors
        from robogauntlet.orchestrator.scheduling.worker_pool import WorkerPoolError

        try:
            self._observers.start()
            self._began = time.monotonic()
            if self._already:
                planned = counted(self._plan.episodes, "episode")
                self._observers.on_line(f"continuing: {self._already:,} of {planned} already done")
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
                self._observers.on_warning(f"{error}; {again}")
        return step()

    def _play_missing(self) -> None:
        if work := self._remaining_work():
            self._play(work)

    def _play(self, work: list[tuple[Cell, Sequence[int]]]) -> None:
        """Play this work and all further rounds. Raises as `Scheduler.run`."""
        import_ray()
        from robogauntlet.orchestrator.inference.ray_policy_server import choose_inference, start_servers
        from robogauntlet.orchestrator.replay.media import end_filming, episodes_to_film, job_of_workers
        from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
        from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
        from robogauntlet.orchestrator.scheduling.work_queue import work_queues

        suite, per_simulator = self._plan.suite, self._run.document.workers
        scheduling = SchedulerOptions(
            workers=per_simulator or room_for_workers,
            episode_time_limit_s=suite.episode_time_limit_s,
            allowed_errors=int(suite.error_tolerance * self._plan.episodes),
            resources=suite.resources,
        )
        fixed = sum(per_simulator.get(name, 0) for name in {cell.simulator for cell, _ in work})
        variables = self._plan.environments.shared_variables(self._plan.simulators)
        self._ray.enter_context(ray_session(address=self._options.address, workers=fixed, variables=variables))
        workers = fixed or room_for_workers()
        sources = self._sources()
        place = choose_inference(sources, self._plan.cells, suite.inference, workers, self._observers.on_line)
        self._update(inference=place, shared_workers=None if per_simulator else workers)
        servers = start_servers(sources, suite.inference) if place == "served" else []
        films = self._options.media is not False and self._options.address is None
        job = job_of_workers(self._place.folder, episodes_to_film(work) if films else ())
        self._ray.callback(end_filming, self._place.folder)
        while work:
            pool = RayWorkerPool(sources, suite.resources, servers, self._plan.environments, job)
            queues = work_queues(work, suite.max_attempts)
            sink = self._place.add
            Scheduler(queues, pool, scheduling, sink=sink, observer=self._observers, start_s=self._start_s).run()
            before, work = work, self._remaining_work() if suite.adaptive or self._rounds else []
            if work == before:  # the remaining episodes cannot be played here
                break

    def _sources(self) -> Mapping[str, PolicySource]:
        """The policies, with bundles of their files for the nodes of a cluster. Ray must be running."""
        return self._plan.sources if self._options.address is None else with_bundles(self._plan.sources)

    def _remaining_work(self) -> list[tuple[Cell, Sequence[int]]]:
        """The remaining work; if there are rounds, of the current one."""
        outcomes, skipped = self._place.store.outcomes(), self._run.skipped
        if self._rounds is None:
            state = remaining_work(self._plan, outcomes, skipped)
        else:
            state = self._rounds([cell for cell in self._plan.cells if cell.simulator not in skipped], outcomes)
            self._run.progress.replan(state.planned)
        self._update(plan=self._plan.planned_cells(state.planned), decided=tuple(state.decided))
        return state.work

    def conclude(self) -> None:
        """Write the document and the report of what was played."""
        run, digest, played = self._run, None, True
        try:
            self._stay_saved()
            run.cells = self._history.count_cells(run.document.run_id)
            played = any(counts.verdicts for counts in run.cells.values())
            digest = rows_hash(map(outcome_row, self._place.store.results()))
        except (OSError, StoreError) as error:
            if self._status is RunStatus.COMPLETE:
                self._status, self._reason = RunStatus.STOPPED, first_line(describe_os_error(error))
        missing = 0 if run.done is None else run.document.planned - run.done
        if self._status is RunStatus.COMPLETE and missing > 0 and not run.skipped:
            self._status, self._reason = RunStatus.STOPPED, f"{counted(missing, 'episode')} missing"
        if self._status is RunStatus.COMPLETE and not played:
            self._status, self._reason = RunStatus.STOPPED, self._why_nothing()
        self._update(
            status=self._status,
            reason=None if self._reason is None else shortened(self._reason),
            finished_at=time.time(),
            skipped=run.skipped,
            render_devices=run.render_devices,
            rows_hash=digest,
            **self._elapsed(),
        )
        self._write()
        self._observers.on_numbers()

    def _why_nothing(self) -> str:
        """Why no episode was played, in a line."""
        reasons = [f"{name} is skipped: {first_line(reason)}" for name, reason in self._run.skipped.items()]
        return f"no episode was played; {'; '.join(reasons) or 'each ended in an error'}"

    def end(self) -> RunState:
        """Tell the observers that everything is written, and return the outcome."""
        self._observers.on_end()
        return self._run

    def record_media(self) -> None:
        """Record missing videos and snapshots of a complete run and write the report again. Errors become warnings."""
        run = self._run
        if run.document.status is not RunStatus.COMPLETE or self._options.media is False:
            return
        self._phase, self._began = "media_s", time.monotonic()
        self._left_out = 0
        try:
            if not self._through_ray_restarts(self._record_media) and not run.document.media_left_out:
                return
        except KeyboardInterrupt:
            run.media_interrupted = True
        except (NoCluster, RayLost, OSError, StoreError) as error:
            run.warnings.append(f"videos could not be recorded: {describe_os_error(error)}")
        self._update(media_left_out=self._left_out, finished_at=time.time(), **self._elapsed())
        self._write()

    def _pending_media(self) -> Iterator[list[Snapshot | EpisodeResult]]:
        """The first failures to record, and all else."""
        from robogauntlet.orchestrator.replay.media import pending_media
        from robogauntlet.results.analysis.combinations import cluster_failures

        plan, skipped = self._plan, self._run.skipped
        evaluated = [name for name in plan.sources if name not in plan.suite.reference_policies]
        snapshots = condition_snapshots(plan.cells, plan.suite.seeds.start)
        report = self._run.report
        found = None if report is None else report.data.get("combinations")
        in_clusters = cluster_failures(found, self._place.store.results())
        pending = pending_media(self._place.folder, self._place.store.results, evaluated, snapshots, in_clusters)
        return ([item for item in part if item.simulator not in skipped] for part in pending)

    def _record_media(self) -> bool:
        """Record missing videos and snapshots, as many as their time allows. Returns whether any were missing."""
        first, others = self._pending_media()
        missing = [*first, *others]
        self._left_out = total = len(missing)
        share_s = math.inf if self._options.media else MEDIA_SHARE * self._run.document.elapsed_s
        attempted, end = False, self._began + share_s - self._run.document.media_s
        if share_s < FIRST_FAILURES_S and self._run.document.media_s == 0.0:
            attempted, missing = self._record(first, self._began + FIRST_FAILURES_S), others
        attempted = self._record(missing, end) or attempted
        if attempted:
            recorded = counted(total - self._left_out, "video or snapshot", "videos and snapshots")
            self._observers.on_line(f"recorded {recorded} in {format_duration(time.monotonic() - self._began)}")
        return total > 0

    def _record(self, missing: Sequence[Snapshot | EpisodeResult], end: float) -> bool:
        """Record these until `end`, by the clock. Returns whether there was time for any."""
        from robogauntlet.orchestrator.replay.media import record_media

        left_s = end - time.monotonic()
        pending = [item for item in missing if self._start_s.get(item.simulator, 0.0) < left_s]
        if not pending:
            return False
        limit = f", for at most {format_duration(left_s)}" if left_s < math.inf else ""
        self._observers.on_line(
            f"recording {counted(len(pending), 'video or snapshot', 'videos and snapshots')}{limit}"
        )
        run, recording = self._run, Recording(len(pending), end)
        run.phase, run.recording = RECORDING, recording

        def on_recorded(warning: str | None) -> None:
            self._left_out -= warning is None
            if warning is not None and warning not in run.warnings:
                run.warnings.append(warning)
            recording.done += 1
            self._observers.on_tick()

        try:
            self._observers.on_tick()
            self._ray.enter_context(ray_session(address=self._options.address, workers=0))
            left_s, environments = end - time.monotonic(), self._plan.environments
            record_media(self._place.folder, pending, self._sources(), on_recorded, environments, left_s)
        finally:
            run.recording = None
        self._observers.on_tick()
        return True

    def _write(self) -> None:
        """Write the document, and the report unless the run was interrupted before its first row.

        A complete run whose report could not be written is a stopped one.
        """
        run = self._run
        run.report = None
        try:
            self._stay_saved()
            write_run(run.folder, run.document)
            self._history.record(run.document, run.folder, run.cells, self._options.schedule)
            if run.done != 0 or run.document.status is not RunStatus.INTERRUPTED:  # Ctrl-C at the start ends soon
                from robogauntlet.results.report import write_report

                run.report = write_report(run.folder, store_url=self._place.url)
        except (OSError, StoreError) as error:
            reason = f"the report could not be written: {describe_os_error(error)}"
            run.warnings.append(f"{reason}; write it later: robogauntlet report {run.folder}")
            if run.document.status is RunStatus.COMPLETE:
                self._update(status=RunStatus.STOPPED, reason=shortened(reason))

    def _update(self, **values: object) -> None:
        self._run.document = self._run.document.model_copy(update=values)

    def _elapsed(self) -> dict[str, float]:
        """The time that the phase took so far, over all sessions (s), by its field in the document."""
        return {self._phase: getattr(self._run.document, self._phase) + time.monotonic() - self._began}

    def on_tick(self, run: RunState) -> None:
        """Save the elapsed time every `SAVE_ELAPSED_S`, because a killed session cannot save it at its end."""
        if time.monotonic() - self._saved >= SAVE_ELAPSED_S and not self._place.is_lost:
            self._saved = time.monotonic()
            with contextlib.suppress(OSError):  # the store will notice a full disk, and a lost folder
                write_run(run.folder, run.document.model_copy(update=self._elapsed()))
