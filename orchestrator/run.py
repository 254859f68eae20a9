"""Runs a suite into a run folder: begin or continue, play what is missing, film, report."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.adaptive import missing
from orchestrator.beginning import begin, fixed_workers
from orchestrator.choosing import worth_a_look
from orchestrator.chronicle import Chronicle
from orchestrator.cluster import NoRoom, RayLost, check_room, ray_session, room_for_workers
from orchestrator.folders import FolderError, explain, locked
from orchestrator.plan import Plan
from orchestrator.progress import Progress
from orchestrator.runner import Readiness
from orchestrator.sources import PolicySource
from policies.contract import PolicyError
from results.database import without_password
from results.live import Live, LiveWorker
from results.record import EpisodeResult, outcome_row, rows_hash
from results.run import RUN_FILE, RunDocument, RunStatus, store_url, write_run
from results.store import Store, StoreError
from suites.vocabulary import Cell

WORDS = {"worker": "in the workers", "served": "in processes of their own"}
RAY_STARTS = 5
"""Times that Ray is started for one run before its dying ends the run."""
KEEP_S = 10.0
"""Between two writings of how long a run has taken."""


@dataclass(frozen=True)
class RunOptions:
    """How to run, beyond what the suite says."""

    store: str | None = None
    """URL of the store, or None for a file in the run folder."""
    address: str | None = None
    """Ray cluster to join, or None for this machine."""
    retry_errors: bool = False
    """Play episodes again whose row is an error."""
    media: bool = True
    """Film a success and a failure of each policy on each task afterwards, failures along axes, and the first looks."""
    history: str | None = None
    """URL of the store that knows all runs, or None to tell none."""
    schedule: str | None = None
    """The schedule that begins this run, if one does."""


@dataclass
class RunOutcome:
    """How a run ended."""

    folder: Path
    document: RunDocument
    done: int
    """Rows in the store."""
    troubles: list[str] = field(default_factory=list)
    """What the user should know, a line each."""


def run_plan(plan: Plan, folder: Path, options: RunOptions, progress: Progress) -> RunOutcome:
    """Play what is missing of a plan and write everything into `folder`.

    An interruption, a full disk or too many errors end the run early: what came back is kept, the outcome's status
    says so, and running again continues.

    Raises:
        PlanError: The folder holds another run.
        FolderError: The folder cannot be written, or another process runs into it.
        StoreError: The store cannot be opened.
    """
    with locked(folder, for_run=True), contextlib.ExitStack() as stack:
        begun = (folder / RUN_FILE).exists()
        document = begin(plan, folder, options.store)
        store = _store_of(folder, document, options.store, begun=begun)
        stack.callback(store.close)
        _write(folder, document)
        chronicle = Chronicle.open(folder, store, options.history or options.store, options.schedule)
        stack.callback(chronicle.close)
        chronicle.record(document, counted=False)
        if options.retry_errors:
            store.forget_errors()
        session = _Session(plan, folder, options, progress, document, store, chronicle)
        session.play()
        return session.finish()


class _Session:
    """One process's work on a run."""

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        options: RunOptions,
        progress: Progress,
        document: RunDocument,
        store: Store,
        chronicle: Chronicle,
    ) -> None:
        self._chronicle, self._phase = chronicle, "playing"
        self._plan, self._folder, self._options = plan, folder, options
        self._progress, self._document, self._store = progress, document, store
        self._skipped: dict[str, str] = dict(plan.unavailable)
        self._devices: dict[str, str] = dict(document.render_devices)
        self._status = RunStatus.COMPLETE
        self._reason: str | None = None
        self._troubles: list[str] = [f"{name} is skipped: {reason}" for name, reason in plan.unavailable.items()]
        self._began = self._kept = time.monotonic()  # the other clock may be set meanwhile

    def play(self) -> None:
        """Play what is missing; never raises what a run must survive."""
        from orchestrator.crew import CrewError
        from orchestrator.scheduler import TooManyErrors

        work = self._work()
        self._progress.begin(self._plan, self._store.status_counts())
        try:
            for starts_left in reversed(range(RAY_STARTS)):
                try:
                    if work:
                        self._play_with_ray(work)
                    else:
                        self._film()  # what an earlier session did not come to
                    break
                except RayLost as error:
                    if not starts_left:
                        raise
                    self._troubles.append(f"{error}; it was started again")
                    self._progress.say(self._troubles[-1])
                    work = self._work()
        except KeyboardInterrupt:
            self._status, self._reason = RunStatus.INTERRUPTED, "stopped from outside"
        except (TooManyErrors, NoRoom, RayLost, CrewError, PolicyError) as error:
            self._status, self._reason = RunStatus.STOPPED, str(error)
        except (StoreError, OSError) as error:
            self._status, self._reason = RunStatus.STOPPED, str(error)

    def _play_with_ray(self, work: list[tuple[Cell, Sequence[int]]]) -> None:
        """Play this, what an adaptive suite wants to know next, and film.

        Raises:
            Exception: See `Scheduler.run`.
        """
        from orchestrator.ray_crew import RayCrew
        from orchestrator.scheduler import Scheduler, SchedulerOptions

        suite = self._plan.suite
        workers = fixed_workers(self._plan)
        scheduling = SchedulerOptions(
            workers=workers or room_for_workers,
            episode_time_limit_s=suite.episode_time_limit_s,
            max_attempts=suite.max_attempts,
            allowed_errors=int(suite.error_tolerance * self._plan.episodes),
            resources=suite.resources,
        )
        running = {cell.simulator for cell, _ in work}
        with ray_session(address=self._options.address, workers=sum(workers.get(name, 0) for name in running)):
            if not workers:
                shared = {"all simulators": room_for_workers()}
                self._document = self._document.model_copy(update={"workers": shared})
            count = sum(workers.get(name, 0) for name in running) or room_for_workers()
            sources = self._sources()
            servers = self._servers(sources, count)
            with self._progress:
                while work:
                    crew = RayCrew(sources, suite.resources, servers, self._plan.homes)
                    Scheduler(work, crew, scheduling, sink=self._store.add, observer=self).run()
                    before, work = work, self._work() if suite.adaptive else []
                    if work == before:  # what is missing cannot be played here
                        break
            self._film(sources)

    def _sources(self) -> Mapping[str, PolicySource]:
        """The policies, with their files along if other machines are to build them. Ray must be running."""
        from orchestrator.parcels import with_parcels

        return self._plan.sources if self._options.address is None else with_parcels(self._plan.sources)

    def _servers(self, sources: Mapping[str, PolicySource], workers: int) -> list[Any]:
        """Processes that answer for the policies, if the suite wants them or they answer sooner."""
        from orchestrator.serving import measure, start_servers

        inference = self._plan.suite.inference
        place: str = inference.place
        if place != "worker":
            check_room("inference", {"num_gpus": inference.num_gpus})
        if place == "auto":
            self._progress.say("measuring where policies answer sooner")
            times = measure(sources, self._plan.cells, inference, workers)
            place = times.place if times else "worker"
            self._progress.say(f"policies compute {WORDS[place]}: {times}" if times else "no policy looks at images")
        self._document = self._document.model_copy(update={"inference": place})
        return start_servers(sources, inference) if place == "served" else []

    def _work(self) -> list[tuple[Cell, Sequence[int]]]:
        """What is still to be played; with an adaptive suite, of the round that is under way."""
        found = missing(self._plan, self._store.outcomes(), self._skipped)
        self._document = self._document.model_copy(
            update={"plan": self._plan.planned_cells(found.planned), "decided": tuple(found.decided)}
        )
        return found.work

    def finish(self) -> RunOutcome:
        """Write the document and the report."""
        from results.report import write_report

        done = rows = 0
        digest = None
        with contextlib.suppress(StoreError):
            done = sum(self._store.status_counts().values())
            digest = rows_hash(self._outcome_rows())
            rows = done
        planned = self._document.planned
        if self._status is RunStatus.COMPLETE and rows < planned and not self._skipped:
            self._status, self._reason = RunStatus.STOPPED, f"{planned - rows} episodes are missing"
        self._document = self._document.model_copy(
            update={
                "status": self._status,
                "reason": self._reason,
                "finished_at": time.time(),
                "elapsed_s": self._elapsed_s(),
                "skipped": self._skipped,
                "render_devices": self._devices,
                "rows_hash": digest,
            }
        )
        try:
            write_run(self._folder, self._document)
            self._chronicle.record(self._document)
            write_report(self._folder, store_url=self._options.store)
        except (OSError, StoreError) as error:
            self._troubles.append(
                f"the report could not be written: {explain(error)}; write it later: gauntlet report {self._folder}"
            )
        return RunOutcome(self._folder, self._document, done, self._troubles + self._chronicle.troubles)

    def _elapsed_s(self) -> float:
        """What all sessions took so far."""
        return self._document.elapsed_s + time.monotonic() - self._began

    def _keep_time(self) -> None:
        """Write down how long it has taken, now and then: a session that is killed has taken time as well."""
        if time.monotonic() - self._kept >= KEEP_S:
            self._kept = time.monotonic()
            with contextlib.suppress(OSError):  # the store will notice a full disk
                write_run(self._folder, self._document.model_copy(update={"elapsed_s": self._elapsed_s()}))

    def _outcome_rows(self) -> Iterator[tuple[Any, ...]]:
        return map(outcome_row, self._store.results())

    def _film(self, sources: Mapping[str, PolicySource] | None = None) -> None:
        """Film and picture what is worth it and not there yet, with what `_sources` gave, if it was asked."""
        from orchestrator.filming import film_run, to_shoot

        if not self._options.media:
            return
        suite, aside = self._plan.suite, (self._document.gate, *self._document.floors)
        in_question = [name for name in self._plan.sources if name not in aside]
        able = (cell for cell in self._plan.cells if cell.simulator not in self._skipped)
        looks = worth_a_look(able, suite.seeds.start)
        try:
            shots = to_shoot(self._folder, self._store.results, in_question, looks)
            shots = {simulator: own for simulator, own in shots.items() if simulator not in self._skipped}
            if not shots:
                return
            self._progress.say(
                "filming a success and a failure of each policy on each task"
                + (", failures along each axis, and what each condition looks like" if looks else "")
            )
            count = sum(own.count for own in shots.values())
            self._phase = "filming"

            def came() -> None:
                filming.came()
                self._tell()

            with (
                ray_session(address=self._options.address, workers=len(shots)),
                self._progress.filming(count) as filming,
            ):
                self._troubles += film_run(self._folder, shots, sources or self._sources(), came, self._plan.homes)
        except KeyboardInterrupt:
            self._status, self._reason = RunStatus.INTERRUPTED, "stopped from outside"
        except (OSError, StoreError) as error:
            self._troubles.append(f"videos could not be written: {explain(error)}")

    # What the scheduler tells (`scheduler.Observer`).

    def started(self, simulator: str, readiness: Readiness) -> None:
        """A worker has opened its simulator."""
        self._devices[simulator] = readiness.render_device
        self._progress.started(simulator, readiness)

    def skipped(self, simulator: str, reason: str, episodes: int) -> None:
        """A simulator cannot run here."""
        self._skipped[simulator] = reason
        self._troubles.append(f"{simulator} is skipped ({episodes} episodes): {reason}")
        self._progress.say(self._troubles[-1])

    def came(self, results: Sequence[EpisodeResult]) -> None:
        """Rows have come back."""
        self._progress.came(results)

    def trouble(self, simulator: str, message: str) -> None:
        """A worker died or was ended."""
        self._troubles.append(message)
        self._progress.say(message)

    def tick(self, doing: Callable[[], Sequence[LiveWorker]]) -> None:
        """Time passes."""
        self._progress.tick()
        self._tell(doing)

    def _tell(self, doing: Callable[[], Sequence[LiveWorker]] = tuple) -> None:
        def live() -> Live:
            lanes = self._progress.live()
            return Live(at=time.time(), phase=self._phase, simulators=lanes, workers=tuple(doing()), says=self._said())

        self._chronicle.tell(self._document.run_id, live)
        self._keep_time()

    def _said(self) -> tuple[str, ...]:
        return tuple(self._troubles[-10:])


def _store_of(folder: Path, document: RunDocument, url: str | None, *, begun: bool) -> Store:
    """The store of a run; another than the one that the run was begun with must have its rows."""
    if begun and url is not None and without_password(url) != document.store_url:
        return Store.open_begun(folder, document, url)
    return Store.open(store_url(folder, document, url), document.run_id)


def _write(folder: Path, document: RunDocument) -> None:
    try:
        write_run(folder, document)
    except OSError as error:
        raise FolderError(f"{folder}: {explain(error)}") from None
