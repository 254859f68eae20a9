"""Has Ray actors play the lanes of a collection, each a simulator process at one task at a time."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import ray
from ray.exceptions import RayActorError, RayError, RayTaskError

from adapters import catalog
from adapters.contract import AdapterError
from orchestrator.cluster import RayLost, check_alive
from orchestrator.environments.homes import Homes
from orchestrator.lanes import Lane, Played, fair_share
from orchestrator.recording import demonstrate
from orchestrator.runner import EpisodeRunner
from orchestrator.sources import PolicySource
from policies import catalog as policies
from policies.contract import Policy
from suites.vocabulary import Cell

LEASE = 4
"""Episodes handed to a worker at a time."""
SILENCE_S = 420.0
"""Time after which a worker that sends nothing is taken to hang: opening a task and several episodes fit into it."""


class Listener(Protocol):
    """Is told how a collection goes."""

    def say(self, message: str) -> None:
        """A line for the user."""

    def show(self, lanes: Sequence[Lane]) -> None:
        """Called several times a second."""


@ray.remote
class Demonstrator:
    """Plays and records episodes of one simulator."""

    def __init__(self, policy: str, learner: PolicySource | None = None, *, whole: bool = False) -> None:
        # Ctrl-C in a terminal reaches the whole process group. The driver decides what it means.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        self._runner = EpisodeRunner({policy: PolicySource(policy)})
        self._source, self._whole = learner, whole
        self._learner: Policy | None = None
        self._task: str | None = None

    @ray.method(num_returns="streaming")
    def play(self, cell: Cell, seeds: Sequence[int], noise: float) -> Iterator[Played]:
        """Play these seeds, in order.

        Raises:
            AdapterError: The task cannot be opened here.
            PolicyError: The learner cannot be loaded.
        """
        if self._source is not None and self._learner is None:
            self._learner = policies.load(self._source.kind, self._source.options)
        if self._task != cell.task:
            try:
                self._runner.prepare(cell.task, cell.protocol.view)
            except Exception as error:  # a driver that is missing shows as any exception
                lines = str(error).strip().splitlines()
                raise AdapterError(lines[0] if lines else type(error).__name__) from None
            self._task = cell.task
        for seed in seeds:
            yield demonstrate(self._runner, cell.episode(seed), noise, self._learner, whole=self._whole)


@dataclass
class _Slot:
    """A place for one worker."""

    actor: Any = None
    simulator: str = ""
    lane: Lane | None = None
    pending: Any = None
    """The generator that is awaited, or None when idle."""
    seeds: tuple[int, ...] = ()
    """Seeds of the lease that have not come back."""
    heard: float = 0.0


@dataclass
class Gatherer:
    """Plays all lanes. One instance plays once."""

    lanes: Sequence[Lane]
    noise: float
    workers: int
    listener: Listener
    learner: PolicySource | None = None
    """Acts first in every episode."""
    whole: bool = False
    """Whether episodes are recorded from their start, with a learner."""
    homes: Homes = field(default_factory=Homes)
    """In which environment each simulator runs."""
    _slots: list[_Slot] = field(default_factory=list, init=False)

    def run(self) -> None:
        """Play until every lane is complete or given up.

        Raises:
            OSError: What came back cannot be written.
            RayLost: Ray itself has died.
            KeyboardInterrupt: Stopped from outside.
        """
        self._slots = [_Slot() for _ in range(self.workers)]
        try:
            while any(lane.open for lane in self.lanes):
                check_alive()
                for slot in self._slots:
                    if slot.pending is None:
                        self._feed(slot)
                self._listen()
                for lane in self.lanes:
                    lane.flush_if_due()
                self.listener.show(self.lanes)
        except RayLost:
            for slot in self._slots:
                slot.actor = None  # nobody is left to ask to end it
            raise
        finally:
            for slot in self._slots:
                self._end(slot)

    def _feed(self, slot: _Slot) -> None:
        lane = self._choose(slot)
        if lane is None:
            return
        if slot.simulator != lane.simulator:
            self._end(slot)
        if slot.actor is None:
            environment = self.homes.for_ray(catalog.find(lane.simulator))
            actor: Any = Demonstrator
            slot.actor = actor.options(num_cpus=1, max_restarts=0, max_task_retries=0, runtime_env=environment).remote(
                lane.cell.policy, self.learner, whole=self.whole
            )
            slot.simulator = lane.simulator
        slot.lane = lane
        slot.seeds = lane.lease(fair_share(lane, self.workers, LEASE))
        slot.pending = slot.actor.play.remote(lane.cell, slot.seeds, self.noise)
        slot.heard = time.monotonic()

    def _choose(self, slot: _Slot) -> Lane | None:
        """The slot's own lane, else one that nobody plays, else the one with most to do: opening a task costs time."""
        hungry = [lane for lane in self.lanes if lane.wanted]
        if slot.lane in hungry:
            return slot.lane
        busy = [other.lane for other in self._slots if other.pending is not None]
        return max(
            hungry, key=lambda lane: (lane not in busy, lane.simulator == slot.simulator, lane.wanted), default=None
        )

    def _listen(self) -> None:
        pending = {id(slot.pending): slot for slot in self._slots if slot.pending is not None}
        if not pending:
            return
        waiting = [slot.pending for slot in pending.values()]
        ready, _ = ray.wait(waiting, num_returns=1, timeout=0.2, fetch_local=False)
        for item in ready:
            self._hear(pending[id(item)])
        for slot in pending.values():
            if slot.pending is not None and time.monotonic() - slot.heard > SILENCE_S:
                self._bury(slot, f"no episode came back for {SILENCE_S:g} s")

    def _hear(self, slot: _Slot) -> None:
        lane = slot.lane
        assert lane is not None
        slot.heard = time.monotonic()
        try:
            played: Played = ray.get(next(slot.pending))
        except StopIteration:
            slot.pending = None
        except RayActorError:
            self._bury(slot, "the worker process died")
        except RayTaskError as error:
            lane.give_up(str(error.cause).strip().splitlines()[0])
            self._bury(slot, "the task could not be opened")
        else:
            slot.seeds = tuple(seed for seed in slot.seeds if seed != played[0].seed)
            lane.take(played)

    def _bury(self, slot: _Slot, reason: str) -> None:
        assert slot.lane is not None
        self.listener.say(f"{slot.lane.task}: {reason}")
        slot.lane.lose(slot.seeds, reason)
        self._end(slot)

    def _end(self, slot: _Slot) -> None:
        if slot.actor is not None:
            with contextlib.suppress(RayError, ValueError):
                ray.kill(slot.actor)
        slot.actor = slot.pending = slot.lane = None
        slot.simulator, slot.seeds = "", ()
