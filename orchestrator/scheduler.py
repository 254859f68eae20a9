"""Fans episodes over workers and brings every row home once, whatever dies on the way.

What carries the workers is the crew's business (`crew`): Ray, or in tests a simulation of a thousand of them.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from orchestrator.cluster import RayLost
from orchestrator.crew import Crew, CrewError, Returned, Started, Unavailable, Word, Worker, WorkerLost
from orchestrator.placing import Demand, most_needed
from orchestrator.queue import WorkQueue
from orchestrator.runner import Lease, Readiness
from results.live import LiveWorker
from results.record import EpisodeResult, Status
from suites.placement import Resources
from suites.vocabulary import Cell

OPEN_ALLOWANCE_S = 180.0
"""Added to the time limit while a worker starts, imports its simulator and opens a task."""
RECYCLE_AFTER = 5000
"""Episodes after which a worker is replaced: renderers leak."""
GROW_S = 5.0
"""Time after which it is asked again how many workers there may be."""
START_ATTEMPTS = 3
"""Times that a worker may die while it opens its simulator before the simulator is given up."""
PATROL_S = 0.5
"""Time after which silent workers are looked for again."""
LISTEN_S = 0.2
"""Longest time for which the scheduler waits for a word."""
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

    def tick(self, doing: Callable[[], Sequence[LiveWorker]]) -> None:
        """Called several times a second. `doing` says what each worker does, if asked."""


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
    resources: Mapping[str, Resources] = field(default_factory=dict)
    """Simulator to what its workers need: the memory beyond which one is replaced once its lease is finished, and how
    many episodes it plays at once."""

    def of(self, simulator: str) -> Resources:
        """What a simulator's workers need."""
        return self.resources.get(simulator, Resources())


@dataclass
class _Slot:
    """A place for one worker, refilled when the worker dies."""

    simulator: str
    """Empty until it is free to choose and has chosen."""
    number: int
    bound: bool = True
    """Whether it always works for the same simulator."""
    worker: Worker | None = None
    running: bool = False
    """Whether its worker has a process, and not only asked for a place."""
    lease: Lease | None = None
    back: int = 0
    """Episodes of the lease that have come back."""
    heard: float = 0.0
    began: float = 0.0
    """When it began to do what it does."""
    open_task: str | None = None
    played: int = 0
    memory_bytes: int = 0

    @property
    def name(self) -> str:
        return f"{self.simulator}-{self.number}"

    def doing(self, since: float) -> LiveWorker:
        """What its worker does, and since when (seconds since 1970)."""
        words = "starts" if self.worker is not None and self.open_task is None else "waits"
        if self.lease is not None:
            cell, seeds = self.lease.cell, self.lease.seeds
            words = f"{cell.policy} on {cell.task}, {cell.condition}, episode {self.back + 1} of {len(seeds)}"
        return LiveWorker(worker=self.name, simulator=self.simulator, doing=words, since=since)


@dataclass
class _Simulator:
    queue: WorkQueue
    first: Cell
    failed_starts: int = 0


@dataclass
class Scheduler:
    """Plays all given work. One instance plays once."""

    work: Sequence[tuple[Cell, Sequence[int]]]
    crew: Crew
    options: SchedulerOptions
    sink: Sink
    observer: Observer
    now: Callable[[], float] = time.monotonic

    _simulators: dict[str, _Simulator] = field(default_factory=dict, init=False)
    _slots: list[_Slot] = field(default_factory=list, init=False)
    _idle: list[_Slot] = field(default_factory=list, init=False)
    _busy: dict[int, _Slot] = field(default_factory=dict, init=False)
    """By the id of its worker, a slot whose worker is to say something: it starts, or plays."""
    _at_work: Counter[str] = field(default_factory=Counter, init=False)
    """Simulator to its number of busy slots."""
    _unsaved: list[EpisodeResult] = field(default_factory=list, init=False)
    _saved_at: float = field(default=0.0, init=False)
    _grown_at: float = field(default=0.0, init=False)
    _errors: int = field(default=0, init=False)
    _patrolled_at: float = field(default=0.0, init=False)

    def run(self) -> None:
        """Play everything. Rows that came back are in the sink when this returns or raises.

        Raises:
            TooManyErrors: The suite's error tolerance is used up.
            RayLost: What carries the workers has died.
            CrewError: Nobody can be heard.
            KeyboardInterrupt: Stopped from outside.
            Exception: Whatever the sink raises (a full disk, a lost database).
        """
        try:
            self._prepare()
            while self._active():
                self.crew.check()
                self._grow()
                self._feed_the_idle()
                self._listen()
                self._end_the_silent()
                self.crew.sweep()
                self._save()
                self.observer.tick(self.doing)
            self._save(at_once=True)
        except (KeyboardInterrupt, TooManyErrors, RayLost, CrewError):
            self._save(at_once=True)
            raise
        finally:
            for slot in self._slots:
                self._discard(slot)
            self.crew.close()

    def doing(self) -> list[LiveWorker]:
        """What each worker does."""
        return [slot.doing(since=time.time() - (self.now() - slot.began)) for slot in self._slots if slot.simulator]

    def _prepare(self) -> None:
        by_simulator: dict[str, list[tuple[Cell, Sequence[int]]]] = {}
        for cell, seeds in self.work:
            if len(seeds):
                by_simulator.setdefault(cell.simulator, []).append((cell, seeds))
        for name, work in by_simulator.items():
            episodes = sum(len(seeds) for _, seeds in work)
            count = 1 if callable(self.options.workers) else min(self.options.workers[name], episodes)
            at_once = self.options.of(name).at_once
            queue = WorkQueue(work, workers=count, max_attempts=self.options.max_attempts, at_once=at_once)
            self._simulators[name] = _Simulator(queue, work[0][0])
            if not callable(self.options.workers):
                self._add([_Slot(name, number) for number in range(count)])

    def _grow(self) -> None:
        """Take up places that have been added, where workers are not counted by simulator."""
        if not callable(self.options.workers) or (self._slots and self.now() - self._grown_at < GROW_S):
            return
        self._grown_at = self.now()
        numbers = range(len(self._slots), max(1, self.options.workers()))
        self._add([_Slot("", number, bound=False) for number in numbers])
        for simulator in self._simulators.values():
            simulator.queue.workers = len(self._slots)

    def _add(self, slots: Sequence[_Slot]) -> None:
        self._slots += slots
        self._idle += slots

    def _active(self) -> bool:
        return bool(self._busy) or self._waiting

    @property
    def _waiting(self) -> bool:
        """Whether there are episodes that no worker holds."""
        return any(simulator.queue.waiting for simulator in self._simulators.values())

    def _feed_the_idle(self) -> None:
        idle, self._idle = self._idle, []
        for slot in idle:
            if slot.worker is not None or self._waiting:
                self._feed(slot)
            if id(slot.worker) not in self._busy:
                self._idle.append(slot)

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
        if slot.worker is not None and self._worn_out(slot):
            self._discard(slot)
        slot.heard = slot.began = self.now()
        if slot.worker is None:
            slot.worker = self.crew.start(slot.name, slot.simulator, simulator.first)
            self._await(slot, slot.worker)
            return
        slot.lease, slot.back = simulator.queue.lease(slot.open_task), 0
        if slot.lease is not None:
            slot.worker.play(slot.lease)
            self._await(slot, slot.worker)

    def _await(self, slot: _Slot, worker: Worker) -> None:
        self._busy[id(worker)] = slot
        self._at_work[slot.simulator] += 1

    def _rest(self, slot: _Slot) -> None:
        """A slot has nothing more to wait for."""
        if self._busy.pop(id(slot.worker), None) is not None:
            self._at_work[slot.simulator] -= 1
            self._idle.append(slot)

    def _worn_out(self, slot: _Slot) -> bool:
        limit = self.options.of(slot.simulator).memory_bytes
        return slot.played >= RECYCLE_AFTER or (limit is not None and slot.memory_bytes > limit)

    def _simulator_for(self, slot: _Slot) -> str:
        """What an idle slot should work for: the same as before as long as there is work."""
        if slot.bound or (slot.simulator and self._simulators[slot.simulator].queue.waiting) or not self._waiting:
            return slot.simulator
        demands = {name: Demand(one.queue.waiting_s, self._at_work[name]) for name, one in self._simulators.items()}
        return most_needed(demands) or slot.simulator

    def _listen(self) -> None:
        """Wait briefly for workers to say something, and take in what they say."""
        if not self._busy:
            return
        for worker in self.crew.wait(LISTEN_S):
            slot = self._busy[id(worker)]
            try:
                word = worker.hear()
            except WorkerLost as loss:
                self._buried(slot, str(loss))
            else:
                self._heard(slot, word)

    def _heard(self, slot: _Slot, word: Word) -> None:
        slot.heard = self.now()
        simulator = self._simulators[slot.simulator]
        match word:
            case Started():
                slot.running = True
            case Readiness():
                self._rest(slot)
                slot.open_task = simulator.first.task
                simulator.failed_starts = 0
                self.observer.started(slot.simulator, word)
            case Unavailable(reason):
                self._discard(slot)
                self._give_up(slot.simulator, reason)
            case Returned(results, memory_bytes, last) if slot.lease is not None:
                lease = slot.lease
                slot.back += len(results)
                slot.played += len(results)
                slot.memory_bytes = memory_bytes
                slot.open_task = lease.cell.task
                simulator.queue.measured(lease.cell, results)
                if last:
                    simulator.queue.finished(lease)
                    slot.lease = None
                    self._rest(slot)
                self._take(results)

    def _give_up(self, name: str, reason: str) -> None:
        """Leave out what is left for a simulator that cannot be opened."""
        dropped = self._simulators[name].queue.drop()
        if dropped:
            self.observer.skipped(name, reason, dropped)

    def _buried(self, slot: _Slot, reason: str) -> None:
        """A worker has died or was ended. Put its work back."""
        simulator = self._simulators[slot.simulator]
        lease, back = slot.lease, slot.back
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
        if self.now() - self._patrolled_at < PATROL_S:
            return
        self._patrolled_at = self.now()
        for slot in list(self._busy.values()):
            if not slot.running:
                continue
            opening = slot.lease is None or slot.open_task != slot.lease.cell.task
            allowed = OPEN_ALLOWANCE_S if opening else 0.0
            allowed += slot.lease.message_s if slot.lease is not None else 0.0
            limit = self.options.episode_time_limit_s * self.options.of(slot.simulator).at_once + allowed
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
        """End a slot's worker, if it has one."""
        if slot.worker is not None:
            self._rest(slot)
            self.crew.end(slot.worker)
        slot.worker = slot.lease = slot.open_task = None
        slot.running = False
        slot.played = slot.memory_bytes = 0
