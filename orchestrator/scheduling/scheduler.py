"""Distributes episodes to workers and stores each result exactly once, despite worker failures.

A `WorkerPool` supplies the workers: Ray actors, or in tests a simulation of a thousand of them.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from robogauntlet.orchestrator.episodes.lease import Readiness
from robogauntlet.orchestrator.ray_runtime.session import RayLost
from robogauntlet.orchestrator.scheduling import worker_pool
from robogauntlet.orchestrator.scheduling.slot import ROOM_S, Slot
from robogauntlet.orchestrator.scheduling.work_queue import Outcome, Result, WorkSource, next_simulator
from robogauntlet.results.live_status import LiveWorker
from robogauntlet.results.record import Status, is_left_out
from robogauntlet.suites.resources import Resources
from robogauntlet.support.text import counted

OPEN_ALLOWANCE_S = 180.0
"""Added to the time limit while a worker starts, imports its simulator and opens a task."""
LOAD_ALLOWANCE_S = 180.0
"""Added to the time limit while a worker, or its policy server, loads a policy."""
RECYCLE_AFTER = 5000
"""Episodes after which a worker is replaced, because renderers leak memory."""
GROW_S = 5.0
"""Time between two checks of how many workers fit."""
START_ATTEMPTS = 3
"""Consecutive workers that may die while they open a simulator before the simulator is skipped. Those that started
before the latest of these deaths do not count: with a node, all workers on it die."""
WATCHDOG_S = 0.5
"""Time between two searches for unresponsive workers."""
EVENT_WAIT_S = 0.2
"""Longest time that the scheduler waits for an event."""
FLUSH_S = 1.0
FLUSH_ROWS = 2000
Observed = TypeVar("Observed", bound=Outcome, contravariant=True)


class SchedulerObserver(Generic[Observed]):
    """Callbacks of the scheduler. By default they do nothing."""

    def on_started(self, simulator: str, readiness: Readiness) -> None:
        """A worker has opened its simulator."""

    def on_skipped(self, simulator: str, reason: str, episodes: int) -> None:
        """A simulator cannot run here, and this number of episodes is skipped."""

    def on_results(self, results: Sequence[Observed]) -> None:
        """Workers have returned results."""

    def on_warning(self, message: str) -> None:
        """A worker died or was killed."""

    def on_tick(self, activity: Callable[[], Sequence[LiveWorker]]) -> None:
        """Called several times a second. `activity` returns what each worker is doing."""


class TooManyErrors(Exception):
    """More episodes ended in errors than the suite tolerates."""


@dataclass(frozen=True)
class SchedulerOptions:
    """Number of workers and limits."""

    workers: Mapping[str, int] | Callable[[], int]
    """Simulator to number of workers, or a function that returns the current total for all simulators together."""
    episode_time_limit_s: float
    allowed_errors: int
    """Errors in one session beyond which the run stops."""
    resources: Mapping[str, Resources] = field(default_factory=dict)
    """Simulator to the resources of its workers. A worker above the memory limit is replaced after its lease."""


@dataclass
class Scheduler(Generic[Result]):
    """Plays all given work. An instance is used once."""

    work: Mapping[str, WorkSource[Result]]
    """Simulator to its episodes."""
    pool: worker_pool.WorkerPool
    options: SchedulerOptions
    sink: Callable[[Sequence[Result]], object]
    """Stores results, or raises."""
    observer: SchedulerObserver[Result]
    now: Callable[[], float] = time.monotonic
    start_s: dict[str, float] = field(default_factory=dict)
    """Simulator to the time that its latest worker took from the start of its process to its first result."""

    _slots: list[Slot] = field(default_factory=list, init=False)
    _idle: list[Slot] = field(default_factory=list, init=False)
    _busy: dict[int, Slot] = field(default_factory=dict, init=False)
    """Slots whose workers start or play, by the id of the worker."""
    _busy_counts: Counter[str] = field(default_factory=Counter, init=False)
    """Simulator to its number of busy slots."""
    _failed_starts: Counter[str] = field(default_factory=Counter, init=False)
    """Simulator to the number of workers that died at their start since one succeeded."""
    _failed_at: dict[str, float] = field(default_factory=dict, init=False)
    """Simulator to the latest time at which this number grew."""
    _unsaved: list[Result] = field(default_factory=list, init=False)
    _saved_at: float = field(default=0.0, init=False)
    _grown_at: float = field(default=0.0, init=False)
    _looked_for_room_at: float = field(default=0.0, init=False)
    _errors: int = field(default=0, init=False)
    _watched_at: float = field(default=0.0, init=False)

    def run(self) -> None:
        """Play everything. All returned results are in the sink when this returns or raises.

        Raises:
            TooManyErrors: More episodes ended in errors than the options allow.
            RayLost: Ray itself has died.
            WorkerPoolError: Ray cannot wait for the workers.
            KeyboardInterrupt: The user interrupted the run.
            Exception: Whatever the sink raises (a full disk, a lost database).
        """
        try:
            self._prepare()
            while self._waiting or any(slot.lease for slot in self._slots):
                self.pool.check()
                self._grow()
                self._assign_idle_slots()
                self._process_events()
                self._kill_unresponsive()
                self._replace_workers_without_room()
                self.pool.reap()
                self._save()
                self.observer.on_tick(self.activity)
            self._save(force=True)
        except (KeyboardInterrupt, TooManyErrors, RayLost, worker_pool.WorkerPoolError):
            self._save(force=True)
            raise
        finally:
            for slot in self._slots:
                self._discard(slot)
            self.pool.close()

    def activity(self) -> list[LiveWorker]:
        """What each worker is doing."""
        offset = time.time() - self.now()
        return [slot.activity(since=offset + slot.activity_began) for slot in self._slots if slot.simulator]

    def _prepare(self) -> None:
        if callable(self.options.workers):
            return
        for name, source in self.work.items():
            source.workers = min(self.options.workers[name], source.waiting)
            self._add([Slot(name, number) for number in range(source.workers)])

    def _grow(self) -> None:
        """Add slots when more workers fit, unless the number of workers is given per simulator."""
        if not callable(self.options.workers) or (self._slots and self.now() - self._grown_at < GROW_S):
            return
        self._grown_at = self.now()
        numbers = range(len(self._slots), max(1, self.options.workers()))
        self._add([Slot("", number, bound=False) for number in numbers])
        for source in self.work.values():
            source.workers = len(self._slots)

    def _replace_workers_without_room(self) -> None:
        """Replace workers that find no node with free resources, if others would find one.

        Others are workers of the same simulator, if nodes have joined or left since, and those of other simulators,
        unless the slot is bound. Called after events are handled, so that no worker counts as waiting because the
        scheduler was busy.
        """
        if self.now() - self._looked_for_room_at < GROW_S:
            return
        self._looked_for_room_at = self.now()
        waiting = [slot for slot in self._slots if slot.waits_for_room(self.now())]
        moved = self._elsewhere(waiting)
        for slot in moved:
            self._end_waiting(slot)
        free = [slot for slot in waiting if slot.worker is not None and not slot.bound]
        room = {name: self.pool.room(name) for name, source in self.work.items() if source.waiting} if free else {}
        given = len(moved)
        for slot in free:
            # A worker that moves may take this room from every simulator, if all of it is on one node.
            others = [name for name, workers in room.items() if workers > given and name != slot.simulator]
            if room.get(slot.simulator, 0) > 0 or not (name := self._most_urgent(others)):
                continue
            self._end_waiting(slot)
            slot.next_simulator = name
            given += 1

    def _elsewhere(self, slots: Sequence[Slot]) -> list[Slot]:
        """Those whose workers would find other nodes if they were started now."""
        workers = [slot.worker for slot in slots if slot.worker is not None]
        found = {id(worker) for worker in (self.pool.placeable_elsewhere(workers) if workers else ())}
        return [slot for slot in slots if id(slot.worker) in found]

    def _end_waiting(self, slot: Slot) -> None:
        """End a worker that waits for room. A slow start cannot be told from that, so the next may take longer."""
        self._discard(slot)
        slot.patience_s *= 2

    def _add(self, slots: Sequence[Slot]) -> None:
        self._slots += slots
        self._idle += slots

    @property
    def _waiting(self) -> bool:
        """Whether there are episodes that no worker holds."""
        return any(source.waiting for source in self.work.values())

    def _assign_idle_slots(self) -> None:
        idle, self._idle = sorted(self._idle, key=lambda slot: slot.worker is None), []
        for slot in idle:
            if slot.worker is not None or self._waiting:
                self._assign(slot)
            if id(slot.worker) not in self._busy:
                self._idle.append(slot)

    def _assign(self, slot: Slot) -> None:
        """Start a worker in an idle slot, or lease episodes to its worker, if any episodes are waiting."""
        if slot.worker is not None and self._needs_recycling(slot):
            self._discard(slot)
        name = self._simulator_for(slot)
        if name != slot.simulator:
            self._discard(slot)
            slot.simulator = name
        source = self.work.get(slot.simulator)
        if source is None or not source.waiting:
            self._discard(slot)  # another simulator's worker may wait for room
            return
        slot.last_event_at = slot.activity_began = self.now()
        if slot.worker is None:
            slot.worker, slot.opening = self.pool.start(slot.name, slot.simulator, source.first), source.first.task
            self._mark_busy(slot, slot.worker)
            return
        slot.lease, slot.finished = source.lease(slot.open_task), 0
        if slot.lease is not None:
            slot.worker.play(slot.lease)
            self._mark_busy(slot, slot.worker)

    def _mark_busy(self, slot: Slot, worker: worker_pool.Worker) -> None:
        self._busy[id(worker)] = slot
        self._busy_counts[slot.simulator] += 1

    def _mark_idle(self, slot: Slot) -> None:
        if self._busy.pop(id(slot.worker), None) is not None:
            self._busy_counts[slot.simulator] -= 1
            self._idle.append(slot)

    def _needs_recycling(self, slot: Slot) -> bool:
        limit = self.options.resources.get(slot.simulator, Resources()).memory_bytes
        return slot.played >= RECYCLE_AFTER or (limit is not None and slot.memory_bytes > limit)

    def _simulator_for(self, slot: Slot) -> str:
        """The simulator that an idle slot should serve: the same as before while it has episodes waiting."""
        chosen, slot.next_simulator = slot.next_simulator, ""
        if chosen or slot.bound or (slot.worker and self.work[slot.simulator].waiting) or not self._waiting:
            return chosen or slot.simulator
        # The expected time of no episodes may be a rounding error above 0.
        return self._most_urgent([name for name, source in self.work.items() if source.waiting])

    def _most_urgent(self, simulators: Sequence[str]) -> str:
        """The one that a further worker should serve; empty if that is not worthwhile for any."""
        backlogs = {name: (self.work[name].waiting_s, self._busy_counts[name]) for name in simulators}
        return next_simulator(backlogs, self.start_s) or ""

    def _process_events(self) -> None:
        """Wait briefly for events and handle them."""
        if not self._busy:
            return
        for worker in self.pool.wait(EVENT_WAIT_S):
            slot = self._busy[id(worker)]
            try:
                event = worker.next_event()
            except worker_pool.WorkerLost as loss:
                self._worker_failed(slot, str(loss))
            else:
                self._handle_event(slot, event)

    def _handle_event(self, slot: Slot, event: worker_pool.WorkerEvent) -> None:
        slot.last_event_at = self.now()
        source = self.work[slot.simulator]
        match event:
            case worker_pool.Started():
                slot.running, slot.started_at, slot.patience_s = True, self.now(), ROOM_S
            case Readiness():
                self._mark_idle(slot)
                slot.open_task = slot.opening
                self._failed_starts[slot.simulator] = 0
                self.observer.on_started(slot.simulator, event)
            case worker_pool.Unavailable(reason) if slot.lease is None and self._elsewhere([slot]):
                self._worker_failed(slot, reason)  # on a node that joined, and lacks what others have
            case worker_pool.Unavailable(reason):
                task = slot.lease.cell.task if slot.lease is not None else slot.opening
                self._discard(slot)
                self._give_up(slot.simulator, task, reason)
            case worker_pool.EpisodesFinished(results, memory_bytes, last) if slot.lease is not None:
                lease = slot.lease
                slot.loaded.add(lease.cell.policy)
                slot.memory_bytes = memory_bytes
                if not results:
                    return
                if not slot.played:
                    self.start_s[slot.simulator] = self.now() - slot.started_at
                slot.finished += len(results)
                slot.played += len(results)
                slot.open_task = lease.cell.task
                source.returned(lease, results)
                if last:
                    source.finished(lease)
                    slot.lease = None
                    self._mark_idle(slot)
                self._accept(results)

    def _give_up(self, name: str, task: str, reason: str) -> None:
        """Skip the episodes that cannot be played because a task cannot be opened."""
        self._failed_starts[name] = 0
        dropped = self.work[name].drop(task, reason)
        if dropped:
            self.observer.on_skipped(name, reason, dropped)

    def _worker_failed(self, slot: Slot, reason: str) -> None:
        """Discard a worker that died or hangs, and put its episodes back into the queue."""
        lease, finished, opening = slot.lease, slot.finished, slot.opening
        self._discard(slot)
        if lease is not None:
            self.observer.on_warning(f"{slot.name}: {reason}; its episodes go back into the queue")
            self._accept(self.work[slot.simulator].lost(lease, lease.seeds[finished:], reason))
            return
        self.observer.on_warning(f"{slot.name}: {reason} while opening {opening}")
        if slot.activity_began < self._failed_at.get(slot.simulator, 0.0):
            return
        self._failed_at[slot.simulator] = self.now()
        self._failed_starts[slot.simulator] += 1
        if self._failed_starts[slot.simulator] >= START_ATTEMPTS:
            self._give_up(slot.simulator, opening, f"{reason} while opening {opening}, {START_ATTEMPTS} times")

    def _kill_unresponsive(self) -> None:
        """Kill workers that have sent no event for longer than an episode may take.

        A worker that has not started yet has no process: Ray has no room for it until another worker ends.
        """
        if self.now() - self._watched_at < WATCHDOG_S:
            return
        self._watched_at = self.now()
        for slot in list(self._busy.values()):
            if not slot.running:
                continue
            limit_s = self.options.episode_time_limit_s
            what, allowed_s = "an episode", limit_s
            if slot.lease is not None and slot.lease.cell.policy not in slot.loaded:
                allowed_s = limit_s = limit_s + LOAD_ALLOWANCE_S
                what = f"loading policy '{slot.lease.cell.policy}'"
            elif slot.lease is None or slot.open_task != slot.lease.cell.task:
                limit_s += OPEN_ALLOWANCE_S
            if slot.lease is not None:
                limit_s += slot.lease.message_s
            if self.now() - slot.last_event_at > limit_s:
                self._worker_failed(slot, f"{what} took longer than {allowed_s:g} s")

    def _accept(self, results: Sequence[Result]) -> None:
        if not results:
            return
        self._unsaved += results
        self.observer.on_results(results)
        errors = [r.error for r in results if r.status == Status.ERROR and not is_left_out(r.error)]
        self._errors += len(errors)
        if errors and self._errors > self.options.allowed_errors:
            raise TooManyErrors(
                f"{counted(self._errors, 'episode')} ended in an error, "
                f"the suite tolerates {self.options.allowed_errors}; latest: {errors[-1]}"
            )

    def _save(self, *, force: bool = False) -> None:
        due = self.now() - self._saved_at >= FLUSH_S or len(self._unsaved) >= FLUSH_ROWS
        if self._unsaved and (due or force):
            self.sink(self._unsaved)
            self._unsaved = []
            self._saved_at = self.now()

    def _discard(self, slot: Slot) -> None:
        """End a slot's worker, if it has one."""
        if slot.worker is not None:
            self._mark_idle(slot)
            self.pool.end(slot.worker)
        slot.worker = slot.lease = slot.open_task = None
        slot.running = False
        slot.loaded = set()
        slot.played = slot.memory_bytes = 0
