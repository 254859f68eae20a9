"""Runs a suite into a run folder: begin or continue, play what is missing, film, report."""

from __future__ import annotations

import contextlib
import errno
import os
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from adapters import catalog as simulators
from orchestrator import provenance
from orchestrator.adaptive import missing
from orchestrator.choosing import worth_a_look
from orchestrator.cluster import NoRoom, RayLost, check_room, ray_session, room_for_workers
from orchestrator.plan import Plan, PlanError, check_same
from orchestrator.progress import Progress
from orchestrator.runner import Readiness
from orchestrator.sources import PolicySource
from policies.contract import PolicyError
from results.record import EpisodeResult, outcome_row, rows_hash
from results.run import RUN_FILE, RunDocument, RunStatus, read_run, store_url, write_run
from results.store import Store, StoreError
from suites.vocabulary import Cell

WORDS = {"worker": "in the workers", "served": "in processes of their own"}
RAY_STARTS = 5
"""Times that Ray is started for one run before its dying ends the run."""


class FolderError(Exception):
    """The run folder cannot be used; the message says why."""


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
    with locked(folder), contextlib.ExitStack() as stack:
        document = _begin(plan, folder, options)
        store = Store.open(store_url(folder, document, options.store), document.run_id)
        stack.callback(store.close)
        store.begin_run({"suite": plan.suite.name, "suite_hash": plan.suite_hash})
        if options.retry_errors:
            store.forget_errors()
        _write(folder, document)
        session = _Session(plan, folder, options, progress, document, store)
        session.play()
        return session.finish()


class _Session:
    """One process's work on a run."""

    def __init__(
        self, plan: Plan, folder: Path, options: RunOptions, progress: Progress, document: RunDocument, store: Store
    ) -> None:
        self._plan, self._folder, self._options = plan, folder, options
        self._progress, self._document, self._store = progress, document, store
        self._skipped: dict[str, str] = dict(plan.unavailable)
        self._devices: dict[str, str] = dict(document.render_devices)
        self._status = RunStatus.COMPLETE
        self._reason: str | None = None
        self._troubles: list[str] = [f"{name} is skipped: {reason}" for name, reason in plan.unavailable.items()]
        self._began = time.monotonic()  # the other clock may be set meanwhile

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
        workers = _fixed_workers(self._plan)
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
                    crew = RayCrew(sources, suite.resources, servers)
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
                "elapsed_s": self._document.elapsed_s + time.monotonic() - self._began,
                "skipped": self._skipped,
                "render_devices": self._devices,
                "rows_hash": digest,
            }
        )
        try:
            write_run(self._folder, self._document)
            write_report(self._folder, store_url=self._options.store)
        except (OSError, StoreError) as error:
            self._troubles.append(
                f"the report could not be written: {explain(error)}; write it later: gauntlet report {self._folder}"
            )
        return RunOutcome(self._folder, self._document, done, self._troubles)

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
            with (
                ray_session(address=self._options.address, workers=len(shots)),
                self._progress.filming(count) as filming,
            ):
                self._troubles += film_run(self._folder, shots, sources or self._sources(), filming.came)
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

    def tick(self) -> None:
        """Time passes."""
        self._progress.tick()


def _begin(plan: Plan, folder: Path, options: RunOptions) -> RunDocument:
    """The document of a new run, or of the one in `folder` that is to be continued."""
    workers = _fixed_workers(plan)
    if (folder / RUN_FILE).exists():
        document = read_run(folder)
        check_same(plan, document, folder)
        if document.store_url is not None and options.store is None:
            raise PlanError(f"{folder}: its rows are in {document.store_url}; give that address with --store")
        return document.model_copy(
            update={
                "status": RunStatus.RUNNING,
                "reason": None,
                "workers": workers,
                "merging": plan.suite.merging,
                "gate": plan.suite.gate,
                "floors": plan.suite.floors,
                "compare": plan.suite.comparison,
                "regression": plan.suite.regression,
            }
        )
    cards = simulators.task_cards()
    distributions = [d for name in plan.simulators for d in simulators.find(name).distributions]
    return RunDocument(
        run_id=uuid.uuid4().hex,
        suite_name=plan.suite.name,
        suite_description=plan.suite.description,
        suite_hash=plan.suite_hash,
        suite_text=plan.text,
        suite_path=str(plan.path),
        store_url=_without_password(options.store),
        started_at=time.time(),
        plan=plan.planned_cells(),
        unsupported=plan.unsupported,
        instructions={task: cards[task].instruction for task in plan.suite.tasks},
        merging=plan.suite.merging,
        compare=plan.suite.comparison,
        adaptive=plan.suite.adaptive,
        regression=plan.suite.regression,
        gate=plan.suite.gate,
        floors=plan.suite.floors,
        workers=workers,
        skipped=dict(plan.unavailable),
        provenance=provenance.collect(distributions),
    )


def _fixed_workers(plan: Plan) -> dict[str, int]:
    """Simulator to its number of workers; empty if they are not counted by simulator."""
    if plan.suite.workers == "auto":
        return {}
    return {name: plan.suite.worker_count(name) for name in plan.simulators if name not in plan.unavailable}


def _without_password(url: str | None) -> str | None:
    if url is None:
        return None
    import sqlalchemy as sa

    try:
        return sa.make_url(url).render_as_string(hide_password=True)
    except sa.exc.ArgumentError:
        raise StoreError(
            f"not a store URL: {url}; expected sqlite:///FILE or postgresql+psycopg://HOST/DATABASE"
        ) from None


def _write(folder: Path, document: RunDocument) -> None:
    try:
        write_run(folder, document)
    except OSError as error:
        raise FolderError(f"{folder}: {explain(error)}") from None


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """The folder, made if need be, for this process alone."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / ".lock")
        lock.acquire(timeout=0)
    except Timeout:
        raise FolderError(f"{folder}: another process runs into this folder") from None
    except OSError as error:
        raise FolderError(f"{folder}: {explain(error)}") from None
    try:
        yield
    finally:
        lock.release()


def explain(error: BaseException) -> str:
    """An error in words that say what to do."""
    if isinstance(error, OSError) and error.errno:
        hints: Mapping[int, str] = {
            errno.ENOSPC: "the disk is full; free some space and run again",
            errno.EROFS: "the file system is read-only; choose another folder with --out",
            errno.EACCES: "no permission to write; choose another folder with --out",
            errno.EEXIST: "expected a folder, this is a file",
            errno.ENOTDIR: "expected a folder, this is a file",
        }
        return hints.get(error.errno, os.strerror(error.errno))
    return str(error)
