"""Simulated workers, which drive the real scheduler with thousands of them on one machine.

Its clock runs while the scheduler computes, and jumps to the next event when the scheduler waits. The cost of the
scheduler shows: finished workers stay idle until their results are handled.
"""

import contextlib
import heapq
import itertools
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from robogauntlet.orchestrator.episodes.lease import Readiness
from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
from robogauntlet.orchestrator.scheduling.work_queue import work_queues
from robogauntlet.orchestrator.scheduling.worker_pool import EpisodesFinished, Started, Unavailable, WorkerLost
from robogauntlet.suites.episode import Cell, Protocol
from tests.orchestrator.conftest import RecordingObserver
from tests.results.synthetic import row


class Clock:
    """Seconds since its creation: the scheduler's computing plus simulated waiting.

    Args:
        timer: Measures the computing (s). The default counts processor time, so that a busy machine changes nothing;
            `time.perf_counter` counts waiting for the disk too.
    """

    def __init__(self, timer: Callable[[], float] = time.thread_time):
        self._timer, self._start, self.waited, self.simulating = timer, timer(), 0.0, 0.0

    def __call__(self):
        return self.computed + self.waited

    @property
    def computed(self):
        """Time that the scheduler has computed (s)."""
        return self._timer() - self._start - self.simulating

    @contextlib.contextmanager
    def stopped(self):
        """Time in this block is that of simulated workers and does not count."""
        start = self._timer()
        try:
            yield
        finally:
            self.simulating += self._timer() - start


@dataclass(eq=False)
class SimulatedWorker:
    """Sends its events at drawn times."""

    pool: "SimulatedWorkerPool"
    name: str
    ended: bool = False
    events: deque = field(default_factory=deque)
    """Events that have not been handled."""
    idle_since: float | None = None
    played: int = 0
    loaded: set[str] = field(default_factory=set)
    """Policies that it has loaded."""

    def play(self, lease):
        with self.pool.clock.stopped():
            self.pool.begin(self, lease)

    def next_event(self):
        self.pool.charge(self.pool.event_s)
        event = self.events.popleft()
        if self.events:
            self.pool.ready[id(self)] = self
        if isinstance(event, WorkerLost):
            raise event
        return event


class SimulatedWorkerPool:
    """Workers with drawn durations, which die as `fate` decides.

    Args:
        seconds: Duration of an episode.
        clock: The scheduler's clock.
        start_s: Time until a worker is ready.
        load_s: Time to load a policy.
        event_s: Time to handle an event on a real Ray, besides the computation here.
        wait_s: Time per worker to find the workers with events on a real Ray.
        fate: Called before each episode; "dies" ends the worker there, "hangs" stops its events.
        unavailable: Simulators that cannot be opened.
        memory_bytes: Memory of a worker by the number of its played episodes.
        result: Returns the result of an episode of a lease.
    """

    def __init__(
        self,
        seconds: Callable[[Any], float],
        clock: Clock,
        *,
        start_s: float = 5.0,
        load_s: float = 0.0,
        event_s: float = 0.0,
        wait_s: float = 0.0,
        fate: Callable[[Any], str] = lambda episode: "plays",
        unavailable: Iterable[str] = (),
        memory_bytes: Callable[[int], int] = lambda played: 0,
        result: Callable[..., Any] = lambda lease, seed, **fields: row(
            lease.cell, seed, attempts=lease.attempt, **fields
        ),
    ):
        self.clock, self._seconds, self._start_s, self._fate = clock, seconds, start_s, fate
        self.event_s, self._wait_s, self._load_s, self._result = event_s, wait_s, load_s, result
        self.charged_s = 0.0
        self._unavailable, self._memory_bytes = set(unavailable), memory_bytes
        self._events: list[tuple[float, int, SimulatedWorker, Any]] = []
        self._count = itertools.count()
        self.ready: dict[int, SimulatedWorker] = {}
        self.alive: set[SimulatedWorker] = set()
        self.busy_s = self.idle_s = 0.0
        self.event_count = 0

    def check(self):
        pass

    def reap(self):
        pass

    def close(self):
        assert not self.alive, "workers still run"

    def room(self, simulator):
        return 0

    def placeable_elsewhere(self, workers):
        return []

    def start(self, name, simulator, first):
        worker = SimulatedWorker(self, name)
        self.alive.add(worker)
        now = self.clock()
        ready = Unavailable("not here") if simulator in self._unavailable else Readiness(0, "none", None)
        self._at(now + self._start_s / 2, worker, Started())
        self._at(now + self._start_s, worker, ready)
        return worker

    def end(self, worker):
        worker.ended = True
        self.alive.discard(worker)
        self.ready.pop(id(worker), None)

    def begin(self, worker, lease):
        """Schedule the events of a lease that a worker starts to play."""
        now = self.clock()
        if worker.idle_since is not None:
            self.idle_s += now - worker.idle_since
        if lease.cell.policy not in worker.loaded:
            worker.loaded.add(lease.cell.policy)
            now += self._load_s
            self._at(now, worker, EpisodesFinished([], self._memory_bytes(worker.played), False))
        batch, sent = [], now
        for left, episode in zip(reversed(range(len(lease.seeds))), lease.episodes(), strict=True):
            fate = self._fate(episode)
            if fate != "plays":
                self._send(now, worker, batch)
                if fate == "dies":
                    self._at(now, worker, WorkerLost("the worker process died"))
                return
            seconds = self._seconds(episode)
            now += seconds
            self.busy_s += seconds
            batch.append(self._result(lease, episode.seed, wall_s=seconds, worker=worker.name))
            if not left or now - sent >= lease.message_s:
                self._send(now, worker, batch, last=not left)
                batch, sent = [], now

    def wait(self, timeout_s):
        """Let time pass until a worker has an event."""
        self.charge(self._wait_s * len(self.alive))
        with self.clock.stopped():
            until = self.clock() + timeout_s
            self._deliver_due_events()
            if not self.ready:
                due = min(self._events[0][0], until) if self._events else until
                self.clock.waited += max(0.0, due - self.clock())
                self._deliver_due_events()
            ready, self.ready = list(self.ready.values()), {}
            return ready

    def charge(self, seconds):
        """Count time that the scheduler would need on a real Ray."""
        self.charged_s += seconds
        self.clock.waited += seconds

    def _send(self, when, worker, batch, last=False):
        worker.played += len(batch)
        if batch:
            self._at(when, worker, EpisodesFinished(batch, self._memory_bytes(worker.played), last))

    def _at(self, when, worker, event):
        heapq.heappush(self._events, (when, next(self._count), worker, event))

    def _deliver_due_events(self):
        now = self.clock()
        while self._events and self._events[0][0] <= now:
            when, _, worker, event = heapq.heappop(self._events)
            if worker.ended:
                continue
            self.event_count += 1
            worker.events.append(event)
            self.ready[id(worker)] = worker
            if isinstance(event, Readiness) or (isinstance(event, EpisodesFinished) and event.last):
                worker.idle_since = when


def work(plan):
    """Cells and seeds of a plan, (task, policy) to a number of episodes."""
    return [(Cell(policy, policy, task, Protocol(60)), range(n)) for (task, policy), n in plan.items()]


def play(items, pool, workers, **changes):
    """Play everything in a pool; returns the rows and the observer."""
    observer, rows = RecordingObserver(), []
    given = {"workers": workers, "episode_time_limit_s": 30.0, "allowed_errors": 10**6}
    chosen = SchedulerOptions(**{**given, **changes})
    Scheduler(work_queues(items, 3), pool, chosen, rows.extend, observer, now=pool.clock).run()
    return rows, observer
