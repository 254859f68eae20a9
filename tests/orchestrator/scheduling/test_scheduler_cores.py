"""The scheduler on simulated cores that can open some simulators only, or join late."""

from collections import Counter

import pytest

from robogauntlet.orchestrator.episodes.lease import Readiness
from robogauntlet.orchestrator.scheduling.scheduler import GROW_S
from robogauntlet.orchestrator.scheduling.slot import ROOM_S
from robogauntlet.orchestrator.scheduling.worker_pool import Started, Unavailable
from tests.orchestrator.scheduling.simulated_worker_pool import Clock, SimulatedWorkerPool, play, work


class ClusterPool(SimulatedWorkerPool):
    """Cores that can open some simulators only. A worker waits until such a core is free."""

    def __init__(self, cores, **options):
        super().__init__(lambda episode: 1.0, Clock(), **options)
        self.cores = cores
        """Simulators of each core."""
        self.core, self.queue, self.timeline, self.starts = {}, [], [], []

    def startable(self, worker, simulator):
        """Free cores that a waiting worker may take."""
        return self.free(simulator)

    def free(self, simulator):
        return [n for n, able in enumerate(self.cores) if simulator in able and n not in self.core.values()]

    def room(self, simulator):
        return len(self.free(simulator))

    def start(self, name, simulator, first):
        self.starts.append(self.clock())
        worker = super().start(name, simulator, first)
        self._events = [event for event in self._events if event[2] is not worker]
        self.queue.append((worker, simulator))
        return worker

    def end(self, worker):
        super().end(worker)
        self.core.pop(worker, None)

    def wait(self, timeout_s):
        for worker, simulator in self.queue.copy():
            free = self.startable(worker, simulator)
            if worker.ended or free:
                self.queue.remove((worker, simulator))
            if free and not worker.ended:
                self.core[worker] = free[0]
                self._at(self.clock() + self._start_s / 2, worker, Started())
                self._at(self.clock() + self._start_s, worker, Readiness(0, "none", None))
        self.timeline.append((self.clock(), len(self.core)))
        return super().wait(timeout_s)

    def taken(self, since, until):
        """The smallest number of taken cores between two times."""
        return min(taken for time, taken in self.timeline if since < time < until)


SETTLED_S = ROOM_S + GROW_S + 1.0


def test_a_core_that_one_simulator_cannot_use_serves_another():
    pool = ClusterPool(["ab", "ab", "b"])
    rows, observer = play(work({("a/1", "p"): 300, ("b/1", "p"): 300}), pool, lambda: 3)
    assert Counter(row.simulator for row in rows) == {"a": 300, "b": 300}
    assert pool.taken(SETTLED_S, 120.0) == 3
    assert pool.taken(5.0, ROOM_S) == 2, "the case is none where all find room at once"
    assert not observer.warnings


def test_a_worker_waits_while_no_core_is_free():
    """One worker each, and a second of the simulator that is left when the other is done."""
    pool = ClusterPool(["ab", ""])
    rows, _ = play(work({("a/1", "p"): 300, ("b/1", "p"): 300}), pool, lambda: 2)
    assert len(rows) == 600
    assert len(pool.starts) == 3


def test_a_slow_start_is_not_taken_for_a_lack_of_room_while_there_is_room():
    pool = ClusterPool(["ab", "ab", "ab"], start_s=100.0)
    rows, _ = play(work({("a/1", "p"): 900, ("b/1", "p"): 900}), pool, lambda: 2)
    assert len(rows) == 1800
    assert len(pool.starts) == 2


def test_slow_starts_are_not_taken_for_a_lack_of_room_again_and_again():
    """Whichever simulator a slot serves, its cores are full, and the other's are not."""
    pool = ClusterPool(["a", "b", "b"], start_s=100.0)
    rows, observer = play(work({("a/1", "p"): 900, ("b/1", "p"): 900}), pool, lambda: 2)
    assert len(rows) == 1800
    assert len(pool.starts) <= 8
    assert not observer.warnings


def test_a_worker_whose_start_the_busy_scheduler_has_not_noticed_is_kept():
    class BusyPool(ClusterPool):
        def check(self):
            """Take half a minute once, as while the head of a cluster does not answer."""
            if len(self.core) == 2 and self.clock() < 20.0:
                self.clock.waited += 30.0

    pool = BusyPool(["a", "b", "b"])
    rows, _ = play(work({("a/1", "p"): 300, ("b/1", "p"): 300}), pool, lambda: 2)
    assert len(rows) == 600
    assert len(pool.starts) == 2


def test_the_core_of_a_worker_that_is_replaced_goes_to_a_simulator_without_any(monkeypatch):
    """Of two cores `a` can use the first only, which `b` has taken, since it came first."""
    monkeypatch.setattr("robogauntlet.orchestrator.scheduling.scheduler.RECYCLE_AFTER", 100)
    pool = ClusterPool(["ab", "b"])
    rows, _ = play(work({("b/1", "p"): 1000, ("a/1", "p"): 100}), pool, lambda: 2)
    first = next(number for number, row in enumerate(rows) if row.simulator == "a")
    assert first < 500


def test_of_several_simulators_without_room_each_is_played():
    pool = ClusterPool(["ab", "ac"])
    rows, _ = play(work({(f"{name}/1", "p"): 100 for name in "abc"}), pool, lambda: 2)
    assert Counter(row.simulator for row in rows) == {"a": 100, "b": 100, "c": 100}
    assert pool.taken(SETTLED_S, 90.0) == 2


def test_a_free_core_is_offered_to_one_of_the_workers_that_wait():
    """Of four workers two of `a` find none, and one core is left for `b`."""
    pool = ClusterPool(["a", "b", "b"])
    play(work({("a/1", "p"): 3000, ("b/1", "p"): 300}), pool, lambda: 4)
    assert sum(start < SETTLED_S for start in pool.starts) == 5


class JoiningPool(ClusterPool):
    """A core joins every minute, up to a number of them. Workers wait for the cores that there were at their start."""

    def __init__(self, cores, joining, **options):
        super().__init__(cores, **options)
        self.most, self.known = len(cores) + joining, {}

    def check(self):
        if len(self.cores) < min(self.most, self.clock() / 60.0):
            self.cores.append("a")

    def start(self, name, simulator, first):
        worker = super().start(name, simulator, first)
        self.known[worker] = len(self.cores)
        return worker

    def startable(self, worker, simulator):
        return [core for core in self.free(simulator) if core < self.known[worker]]

    def placeable_elsewhere(self, workers):
        return [worker for worker in workers if self.known[worker] < len(self.cores)]


@pytest.mark.parametrize("workers", [lambda: 2, {"a": 2}], ids=["auto", "given"])
def test_a_worker_that_waits_for_the_nodes_there_were_learns_of_one_that_joins(workers):
    pool = JoiningPool(["a"], joining=1)
    rows, observer = play(work({("a/1", "p"): 600}), pool, workers)
    assert len(rows) == 600
    assert pool.taken(5.0, 60.0) == 1
    assert pool.taken(60.0 + SETTLED_S, 250.0) == 2
    assert not observer.warnings


def test_workers_that_start_slowly_are_not_ended_for_each_node_that_joins():
    pool = JoiningPool(["a", "a"], joining=20, start_s=300.0)
    rows, _ = play(work({("a/1", "p"): 600}), pool, {"a": 2})
    assert len(rows) == 600
    assert len(pool.starts) <= 12


def test_a_node_that_joins_without_a_simulator_ends_none_of_its_episodes():
    class LackingPool(JoiningPool):
        """The core that joins takes a worker that waits for any, which cannot open its simulator there."""

        def startable(self, worker, simulator):
            return self.free(simulator)

        def wait(self, timeout_s):
            if len(self.cores) == 2 and self.queue and self.known[self.queue[0][0]] == 1:
                worker, _ = self.queue.pop(0)
                self._at(self.clock(), worker, Unavailable("not installed"))
            return super().wait(timeout_s)

    pool = LackingPool(["a"], joining=1)
    rows, observer = play(work({("a/1", "p"): 200}), pool, {"a": 2})
    assert len(rows) == 200
    assert observer.warnings == ["a-1: not installed while opening a/1"]
    assert not observer.skipped
