"""Fans episodes over Ray workers and brings every row home once, whatever dies on the way."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import ray
from ray.exceptions import GetTimeoutError, RayActorError, RayError, RaySystemError, RayTaskError

from adapters import catalog
from orchestrator.cluster import RayLost, check_alive
from orchestrator.placing import Demand, most_needed
from orchestrator.queue import WorkQueue
from orchestrator.runner import Lease, PolicySource, Readiness
from orchestrator.worker import start_worker
from results.record import EpisodeResult, Status
from suites.vocabulary import Cell

OPEN_ALLOWANCE_S = 180.0
"""Added to the time limit while a worker starts, imports its simulator and opens a task."""
RECYCLE_AFTER = 5000
"""Episodes after which a worker is replaced: renderers leak."""
GROW_S = 5.0
"""Time after which it is asked again how many workers there may be."""
START_ATTEMPTS = 3
"""Times that a worker may die while it opens its simulator before the simulator is given up."""
KILL_AFTER_S = 2.0
"""Time that Ray has to end a worker's process before it is killed."""
FLUSH_S = 1.0
FLUSH_ROWS = 2000


Sink = Callable[[Sequence[EpisodeResult]], object]
"""Keeps rows, or raises."""


class Observer(Protocol):
    """Is told how the run goes."""

    def started(self, simulator: str, readiness: Readiness) -> None:
        """A worker has opened its simulator."""

    def skipped(self, simulator: str, reason: str, episodes: int) -> None:
        """A simulator cannot run here; so many episodes are left out."""

    def came(self, results: Sequence[EpisodeResult]) -> None:
        """Rows have come back."""

    def trouble(self, simulator: str, message: str) -> None:
        """A worker died or was ended."""

    def tick(self) -> None:
        """Called several times a second."""


class TooManyErrors(Exception):
    """More episodes ended in errors than the suite tolerates."""


@dataclass(frozen=True)
class SchedulerOptions:
    """How to run."""

    workers: Mapping[str, int] | Callable[[], int]
    """Simulator to number of workers; or how many there may be for all simulators together, asked now and then."""
    episode_time_limit_s: float
    max_attempts: int
    allowed_errors: int
    """Errors in one session beyond which the run stops."""
    num_cpus_per_worker: float = 1.0


@dataclass
class _Slot:
    """A place for one worker, refilled when the worker dies."""

    simulator: str
    """Empty until it is free to choose and has chosen."""
    number: int
    bound: bool = True
    """Whether it always works for the same simulator."""
    actor: Any = None
    pid: int | None = None
    node: str = ""
    pending: Any = None
    """The reference (preparing) or generator (playing) that is awaited, or None when idle."""
    lease: Lease | None = None
    back: int = 0
    """Episodes of the lease that have come back."""
    heard: float = 0.0
    open_task: str | None = None
    played: int = 0

    @property
    def name(self) -> str:
        return f"{self.simulator}-{self.number}"


@dataclass
class _Simulator:
    queue: WorkQueue
    first: Cell
    failed_starts: int = 0


@dataclass
class Scheduler:
    """Plays all given work. One instance plays once."""

    work: Sequence[tuple[Cell, Sequence[int]]]
    sources: Mapping[str, PolicySource]
    options: SchedulerOptions
    sink: Sink
    observer: Observer
    now: Callable[[], float] = time.monotonic

    _simulators: dict[str, _Simulator] = field(default_factory=dict, init=False)
    _slots: list[_Slot] = field(default_factory=list, init=False)
    _unsaved: list[EpisodeResult] = field(default_factory=list, init=False)
    _saved_at: float = field(default=0.0, init=False)
    _grown_at: float = field(default=0.0, init=False)
    _errors: int = field(default=0, init=False)
    _condemned: dict[int, float] = field(default_factory=dict, init=False)
    """Process id of an ended worker to the time at which it is killed if it still lives."""

    def run(self) -> None:
        """Play everything. Rows that came back are in the sink when this returns or raises.

        Raises:
            TooManyErrors: The suite's error tolerance is used up.
            RayLost: Ray itself has died.
            KeyboardInterrupt: Stopped from outside.
            Exception: Whatever the sink raises (a full disk, a lost database).
        """
        try:
            self._prepare()
            while self._active():
                check_alive()
                self._grow()
                for slot in self._slots:
                    if slot.pending is None:
                        self._feed(slot)
                self._listen()
                self._end_the_silent()
                self._execute_the_condemned()
                self._save()
                self.observer.tick()
            self._save(at_once=True)
        except (KeyboardInterrupt, TooManyErrors):
            self._save(at_once=True)
            raise
        except (RayLost, RayError):
            self._save(at_once=True)
            try:
                check_alive()
            except RayLost:
                for slot in self._slots:
                    slot.actor = None  # nobody is left to ask to end it
                raise
            raise
        finally:
            for slot in self._slots:
                self._discard(slot)
            while self._condemned:
                self._execute_the_condemned()
                time.sleep(0.02)

    def _prepare(self) -> None:
        by_simulator: dict[str, list[tuple[Cell, Sequence[int]]]] = {}
        for cell, seeds in self.work:
            if len(seeds):
                by_simulator.setdefault(cell.simulator, []).append((cell, seeds))
        for name, work in by_simulator.items():
            episodes = sum(len(seeds) for _, seeds in work)
            count = 1 if callable(self.options.workers) else min(self.options.workers[name], episodes)
            queue = WorkQueue(work, workers=count, max_attempts=self.options.max_attempts)
            self._simulators[name] = _Simulator(queue, work[0][0])
            if not callable(self.options.workers):
                self._slots += [_Slot(name, number) for number in range(count)]

    def _grow(self) -> None:
        """Take up places that have been added, where workers are not counted by simulator."""
        if not callable(self.options.workers) or (self._slots and self.now() - self._grown_at < GROW_S):
            return
        self._grown_at = self.now()
        for number in range(len(self._slots), max(1, self.options.workers())):
            self._slots.append(_Slot("", number, bound=False))
        for simulator in self._simulators.values():
            simulator.queue.workers = len(self._slots)

    def _active(self) -> bool:
        return any(slot.pending is not None for slot in self._slots) or any(
            s.queue.waiting for s in self._simulators.values()
        )

    def _feed(self, slot: _Slot) -> None:
        """Give an idle slot something to do, if there is anything."""
        name = self._simulator_for(slot)
        if name != slot.simulator:
            self._discard(slot)
            slot.simulator = name
        simulator = self._simulators.get(slot.simulator)
        if simulator is None or not simulator.queue.waiting:
            self._discard(slot)  # its place may be what another simulator's worker waits for
            return
        if slot.actor is not None and slot.played >= RECYCLE_AFTER:
            self._discard(slot)
        slot.heard = self.now()
        if slot.actor is None:
            slot.actor = start_worker(
                slot.name,
                catalog.find(slot.simulator),
                self.sources,
                num_cpus=self.options.num_cpus_per_worker,
            )
            slot.pending = slot.actor.hello.remote()
            return
        lease = simulator.queue.lease(slot.open_task)
        if lease is not None:
            slot.lease, slot.back = lease, 0
            slot.pending = slot.actor.play.remote(lease)

    def _simulator_for(self, slot: _Slot) -> str:
        """What an idle slot should work for: the same as before as long as there is work."""
        if slot.bound or (slot.simulator and self._simulators[slot.simulator].queue.waiting):
            return slot.simulator
        at_work = Counter(other.simulator for other in self._slots if other.pending is not None)
        demands = {name: Demand(one.queue.waiting_s, at_work[name]) for name, one in self._simulators.items()}
        return most_needed(demands) or slot.simulator

    def _listen(self) -> None:
        """Wait briefly for workers to say something, and take in what they say."""
        pending = {id(slot.pending): slot for slot in self._slots if slot.pending is not None}
        if not pending:
            return
        waiting = [slot.pending for slot in pending.values()]
        ready, _ = ray.wait(waiting, num_returns=1, timeout=0.2, fetch_local=False)
        if ready and len(waiting) > 1:
            ready, _ = ray.wait(waiting, num_returns=len(waiting), timeout=0, fetch_local=False)
        for item in ready:
            slot = pending[id(item)]
            try:
                self._hear(slot)
            except RayActorError:
                self._buried(slot, "the worker process died")
            except (RaySystemError, RayTaskError, GetTimeoutError) as error:
                self._buried(slot, str(error).strip().splitlines()[0])

    def _hear(self, slot: _Slot) -> None:
        slot.heard = self.now()
        if slot.pid is None:
            first = self._simulators[slot.simulator].first
            slot.pid, slot.node = ray.get(slot.pending)
            slot.pending = slot.actor.prepare.remote(first.task, first.protocol.view)
            return
        if slot.lease is None:
            self._ready(slot, ray.get(slot.pending))
            return
        try:
            results: list[EpisodeResult] = ray.get(next(slot.pending))
        except StopIteration:
            self._simulators[slot.simulator].queue.finished(slot.lease)
            slot.pending = slot.lease = None
            return
        slot.back += len(results)
        slot.played += len(results)
        slot.open_task = slot.lease.cell.task
        self._simulators[slot.simulator].queue.measured(slot.lease.cell, results)
        self._take(results)

    def _ready(self, slot: _Slot, answer: Readiness | str) -> None:
        simulator = self._simulators[slot.simulator]
        slot.pending = None
        if isinstance(answer, str):
            self._discard(slot)
            self._give_up(slot.simulator, answer)
            return
        slot.open_task = simulator.first.task
        simulator.failed_starts = 0
        self.observer.started(slot.simulator, answer)

    def _give_up(self, name: str, reason: str) -> None:
        """Leave out what is left for a simulator that cannot be opened."""
        dropped = self._simulators[name].queue.drop()
        if dropped:
            self.observer.skipped(name, reason, dropped)

    def _buried(self, slot: _Slot, reason: str) -> None:
        """A worker has died or was ended. Put its work back."""
        simulator = self._simulators[slot.simulator]
        lease, back = slot.lease, slot.back
        slot.pending = slot.lease = None
        self._discard(slot)
        if lease is not None:
            self.observer.trouble(slot.simulator, f"{slot.name}: {reason}; its episodes go back into the queue")
            self._take(simulator.queue.lost(lease, lease.seeds[back:], reason))
            return
        simulator.failed_starts += 1
        self.observer.trouble(slot.simulator, f"{slot.name}: {reason} while opening {simulator.first.task}")
        if simulator.failed_starts >= START_ATTEMPTS:
            self._give_up(slot.simulator, f"{reason} while opening {simulator.first.task}, {START_ATTEMPTS} times")

    def _end_the_silent(self) -> None:
        """End workers that have said nothing for longer than an episode may take: they hang.

        One that has not said hello is no process yet: Ray has no place for it until another worker ends.
        """
        for slot in self._slots:
            if slot.pending is None or slot.pid is None:
                continue
            opening = slot.lease is None or slot.open_task != slot.lease.cell.task
            limit = self.options.episode_time_limit_s + (OPEN_ALLOWANCE_S if opening else 0.0)
            if self.now() - slot.heard > limit:
                self._buried(slot, f"an episode took longer than {self.options.episode_time_limit_s:g} s")

    def _take(self, results: Sequence[EpisodeResult]) -> None:
        if not results:
            return
        self._unsaved += results
        self.observer.came(results)
        self._errors += sum(result.status == Status.ERROR for result in results)
        if self._errors > self.options.allowed_errors:
            latest = next(r for r in reversed(results) if r.status == Status.ERROR)
            raise TooManyErrors(
                f"{self._errors} episodes ended in errors, the suite tolerates {self.options.allowed_errors}; "
                f"latest: {latest.error}"
            )

    def _save(self, *, at_once: bool = False) -> None:
        due = self.now() - self._saved_at >= FLUSH_S or len(self._unsaved) >= FLUSH_ROWS
        if self._unsaved and (due or at_once):
            self.sink(self._unsaved)
            self._unsaved = []
            self._saved_at = self.now()

    def _discard(self, slot: _Slot) -> None:
        """End a slot's process. Ray's kill does not end a process that is stopped, so its id is remembered."""
        if slot.actor is not None:
            with contextlib.suppress(RayError, ValueError):
                ray.kill(slot.actor)
        if slot.pid is not None and slot.node == os.uname().nodename:
            self._condemned[slot.pid] = self.now() + KILL_AFTER_S
        slot.actor = slot.pid = slot.open_task = None
        slot.played = 0

    def _execute_the_condemned(self) -> None:
        for pid, deadline in list(self._condemned.items()):
            late = self.now() - deadline
            try:
                os.kill(pid, signal.SIGKILL if late > 0 else 0)
            except (ProcessLookupError, PermissionError):
                del self._condemned[pid]
            else:
                if late > KILL_AFTER_S:
                    del self._condemned[pid]  # dead, and its parent has not taken notice
