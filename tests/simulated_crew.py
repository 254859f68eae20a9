"""A crew of simulated workers, so that the real scheduler can be driven with thousands of them on one machine.

Its clock runs as real time does while the scheduler computes, and jumps to the next event when the scheduler waits. So
what the scheduler costs shows: workers that are done stand idle until they are heard.
"""

import contextlib
import heapq
import itertools
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from orchestrator.crew import Returned, Started, Unavailable, WorkerLost
from orchestrator.runner import Readiness
from tests.results.synthetic import row


class Clock:
    """Seconds since it was made: real ones, less those that simulating took, and those that were waited for."""

    def __init__(self):
        self._start, self.waited, self.simulating = time.perf_counter(), 0.0, 0.0

    def __call__(self):
        return self.computed + self.waited

    @property
    def computed(self):
        """Real seconds that were neither waited for nor spent in simulating: the scheduler's."""
        return time.perf_counter() - self._start - self.simulating

    @contextlib.contextmanager
    def stopped(self):
        """In here, what is done would be done elsewhere, by workers and the machine between."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.simulating += time.perf_counter() - start


@dataclass(eq=False)
class SimulatedWorker:
    """Says its words at the times they were drawn for."""

    crew: "SimulatedCrew"
    name: str
    ended: bool = False
    said: deque = field(default_factory=deque)
    """Words that have not been heard."""
    idle_since: float | None = None
    played: int = 0

    def play(self, lease):
        with self.crew.clock.stopped():
            self.crew.begin(self, lease)

    def hear(self):
        self.crew.charge(self.crew.word_s)
        word = self.said.popleft()
        if self.said:
            self.crew.talkative[id(self)] = self
        if isinstance(word, WorkerLost):
            raise word
        return word


class SimulatedCrew:
    """Workers that take drawn times and die when they are told to.

    Args:
        seconds: Of an episode.
        clock: Also the scheduler's.
        start_s: Time from starting a worker to its being ready.
        word_s: Time that the scheduler needs to hear a word, beyond what it computes here.
        wait_s: Time that it takes to look which workers have one, for each worker.
        fate: Called before each episode; "dies" ends the worker there, "hangs" has it say nothing more.
        unavailable: Simulators that cannot be opened.
        memory_bytes: Held by a worker that has played so many episodes.
    """

    def __init__(
        self,
        seconds: Callable[[Any], float],
        clock: Clock,
        *,
        start_s: float = 5.0,
        word_s: float = 0.0,
        wait_s: float = 0.0,
        fate: Callable[[Any], str] = lambda episode: "plays",
        unavailable: Iterable[str] = (),
        memory_bytes: Callable[[int], int] = lambda played: 0,
    ):
        self.clock, self._seconds, self._start_s, self._fate = clock, seconds, start_s, fate
        self.word_s, self._wait_s = word_s, wait_s
        self.charged_s = 0.0
        self._unavailable, self._memory_bytes = set(unavailable), memory_bytes
        self._events: list[tuple[float, int, SimulatedWorker, Any]] = []
        self._count = itertools.count()
        self.talkative: dict[int, SimulatedWorker] = {}
        self.alive: set[SimulatedWorker] = set()
        self.busy_s = self.idle_s = 0.0
        self.words = 0

    def check(self):
        pass

    def sweep(self):
        pass

    def close(self):
        assert not self.alive, "workers were left behind"

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
        self.talkative.pop(id(worker), None)

    def begin(self, worker, lease):
        """A worker begins to play."""
        now = self.clock()
        if worker.idle_since is not None:
            self.idle_s += now - worker.idle_since
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
            batch.append(row(lease.cell, episode.seed, wall_s=seconds, worker=worker.name, attempts=lease.attempt))
            if not left or now - sent >= lease.message_s:
                self._send(now, worker, batch, last=not left)
                batch, sent = [], now

    def wait(self, timeout_s):
        """Let time pass until somebody has something to say."""
        self.charge(self._wait_s * len(self.alive))
        with self.clock.stopped():
            until = self.clock() + timeout_s
            self._ripen()
            if not self.talkative:
                due = min(self._events[0][0], until) if self._events else until
                self.clock.waited += max(0.0, due - self.clock())
                self._ripen()
            talkative, self.talkative = list(self.talkative.values()), {}
            return talkative

    def charge(self, seconds):
        """Let the scheduler spend time that it does not spend here."""
        self.charged_s += seconds
        self.clock.waited += seconds

    def _send(self, when, worker, batch, last=False):
        worker.played += len(batch)
        if batch:
            self._at(when, worker, Returned(batch, self._memory_bytes(worker.played), last))

    def _at(self, when, worker, word):
        heapq.heappush(self._events, (when, next(self._count), worker, word))

    def _ripen(self):
        now = self.clock()
        while self._events and self._events[0][0] <= now:
            when, _, worker, word = heapq.heappop(self._events)
            if worker.ended:
                continue
            self.words += 1
            worker.said.append(word)
            self.talkative[id(worker)] = worker
            if isinstance(word, Readiness) or (isinstance(word, Returned) and word.last):
                worker.idle_since = when
