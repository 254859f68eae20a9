"""Where campaigns run a command, and which faults they cause there: one machine, or a Ray cluster of three nodes."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

import psutil

from tests.chaos.cluster_nodes import RayCluster, ray_cluster
from tests.chaos.processes import MARK, by_kind, end, marked, names_after

GONE_S = 60.0
"""Time for all processes to end (s). A worker whose raylet is killed while it starts searches for it for 26 s (measured
with Ray 2.60) before it ends."""
LOCK_S = 3.0
POWER_CUT_S = (10.0, 20.0)
"""Shortest and longest time until a node that was killed is started again (s)."""
CUT_OFF_S = (30.0, 60.0)
"""Shortest and longest time that a node is cut off from the network (s)."""
BACK_S = 15.0
"""Time for a node that is connected again to learn whether the head has given it up (s)."""
HEAD_S = 120.0
"""Time for a command to end after the death of the cluster's head (s)."""
PROGRAM = "import sys; from robogauntlet.orchestrator.cli import main; main()"


@dataclass
class Command:
    """A running `robogauntlet run`."""

    process: subprocess.Popen[bytes]
    program: psutil.Process
    """The process that gets signals: `process` itself, or what it started on a node."""
    folder: Path
    log: Path
    place: OneMachine
    is_ending: bool = False
    """Whether it got a signal that ends it."""


Fault = Callable[[Command, random.Random], bool]
"""Causes a fault and returns whether it could."""


def _kill(kind: str, with_signal: int) -> Fault:
    def fault(command: Command, generator: random.Random) -> bool:
        candidates = by_kind(command.place.processes())[kind]
        if not candidates:
            return False
        with contextlib.suppress(psutil.NoSuchProcess):
            generator.choice(candidates).send_signal(with_signal)
        return True

    return fault


def _signal(with_signal: int) -> Fault:
    def fault(command: Command, generator: random.Random) -> bool:
        command.is_ending = True
        with contextlib.suppress(psutil.NoSuchProcess):
            command.program.send_signal(with_signal)
        return True

    return fault


def _lock_store(command: Command, generator: random.Random) -> bool:
    """Hold the store's write lock for a while, as another program that writes to it would."""
    file = command.folder / "episodes.sqlite"
    if not file.exists():
        return False
    with contextlib.closing(sqlite3.connect(file, timeout=30.0, isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        time.sleep(LOCK_S)
        connection.execute("ROLLBACK")
    return True


_EVERYWHERE: dict[str, Fault] = {
    "worker killed": _kill("worker", signal.SIGKILL),
    "worker hung": _kill("playing", signal.SIGSTOP),
    "scheduler killed": _signal(signal.SIGKILL),
    "scheduler terminated": _signal(signal.SIGTERM),
    "interrupted": _signal(signal.SIGINT),
    "store locked": _lock_store,
}


class OneMachine:
    """This machine, on which the command starts Ray itself."""

    faults: Mapping[str, Fault] = {
        **_EVERYWHERE,
        "raylet killed": _kill("raylet", signal.SIGKILL),
        "Ray head killed": _kill("gcs_server", signal.SIGKILL),
    }

    def __init__(self) -> None:
        self.mark = uuid.uuid4().hex
        """What all processes of its commands have in their environment."""

    def processes(self) -> list[psutil.Process]:
        """All processes that a fault may hit."""
        return marked(self.mark)

    def start(self, suite: Path, folder: Path, log: Path) -> Command:
        """Start to play a suite, or continue."""
        with log.open("ab") as stream:
            process = subprocess.Popen(
                self._arguments(suite, folder),
                env={**os.environ, MARK: self.mark},
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        return Command(process, psutil.Process(process.pid), folder, log, self)

    def remaining(self) -> list[str]:
        """Names of the command's processes that still run some time after its end."""
        return names_after(GONE_S, self._of_command)

    def end(self) -> list[str]:
        """Kill all processes of the command, and return the violated expectations that faults have noticed."""
        end(self.mark)
        return []

    def _of_command(self) -> list[psutil.Process]:
        return marked(self.mark)

    def _arguments(self, suite: Path, folder: Path) -> list[str]:
        return [sys.executable, "-c", PROGRAM, "run", str(suite), "--out", str(folder), "--no-media"]


class ThreeNodes(OneMachine):
    """A Ray cluster of three nodes; the command runs on the first, which has the head."""

    def __init__(self, cluster: RayCluster) -> None:
        super().__init__()
        self._cluster, self._pool, self._lock = cluster, ThreadPoolExecutor(), threading.Lock()
        self._away = set[int]()
        """Numbers of the nodes without power or network."""
        self._returning: list[Future[None]] = []
        self._problems: list[str] = []
        self.faults = {
            **_EVERYWHERE,
            "node killed": self._away_fault(self._without_power, POWER_CUT_S),
            "node cut off": self._away_fault(self._without_network, CUT_OFF_S),
            "head killed": self._kill_head,
        }

    def processes(self) -> list[psutil.Process]:
        """All processes that a fault may hit."""
        return [process for node in self._cluster.nodes for process in node.processes()]

    def start(self, suite: Path, folder: Path, log: Path) -> Command:
        """Start to play a suite, or continue; before, start Ray on every node that lacks it."""
        if not self._head():
            self._start_head()
        self._start_lacking()
        arguments = [*self._arguments(suite, folder), "--address", self._cluster.address]
        process = self._cluster.popen(0, arguments, log, {MARK: self.mark})
        nsenter = psutil.Process(process.pid)
        while not nsenter.children():
            time.sleep(0.01)
        return Command(process, nsenter.children()[0], folder, log, self)

    def end(self) -> list[str]:
        """Kill all processes of the command, wait until all nodes are back, and return violated expectations."""
        end(self.mark)
        wait(self._returning)
        failures = [repr(error) for future in self._returning if (error := future.exception())]
        problems, self._problems, self._returning = self._problems + failures, [], []
        return problems

    def _of_command(self) -> list[psutil.Process]:
        """Without those on nodes that nothing reaches now: they end with Ray there, a minute after it lost its head."""
        reached = self._cluster.nodes if self._head() else self._cluster.nodes[:1]
        present = [node for number, node in enumerate(reached) if number not in self._away]
        workers = by_kind(process for node in present for process in node.processes())["worker"]
        return [*marked(self.mark), *workers]

    def _start_head(self) -> None:
        with self._lock:
            for node in self._cluster.nodes:
                node.kill()
            self._cluster.start_ray(0)

    def _start_lacking(self) -> None:
        """Start Ray on every node that lacks it, as a supervisor does."""
        with self._lock:
            nodes = enumerate(self._cluster.nodes)
            lacking = [n for n, node in nodes if n not in self._away and not by_kind(node.processes())["raylet"]]
            with ThreadPoolExecutor() as pool:
                list(pool.map(self._cluster.start_ray, lacking))

    def _away_fault(self, happen: Callable[[int, float], None], seconds: tuple[float, float]) -> Fault:
        """A fault of a node other than that of the head and the command. The campaign goes on meanwhile."""

        def fault(command: Command, generator: random.Random) -> bool:
            present = [number for number in range(1, len(self._cluster.nodes)) if number not in self._away]
            if not present:
                return False
            number = generator.choice(present)
            self._away.add(number)
            self._returning.append(self._pool.submit(leave, number, generator.uniform(*seconds)))
            return True

        def leave(number: int, away_s: float) -> None:
            self._cluster.cut(number, off=True)
            happen(number, away_s)
            self._away.remove(number)
            try:
                if self._head():
                    self._start_lacking()
            except (AssertionError, subprocess.TimeoutExpired):
                if self._head():  # otherwise the next start of the command starts all of them
                    raise

        return fault

    def _without_power(self, number: int, away_s: float) -> None:
        """Its connections end without a last word, as it has been disconnected before."""
        self._cluster.nodes[number].kill()
        time.sleep(away_s)
        self._cluster.cut(number, off=False)

    def _without_network(self, number: int, away_s: float) -> None:
        """Ray ends on the node when it is back, unless the head has not given it up yet."""
        time.sleep(away_s)
        self._cluster.cut(number, off=False)
        node = self._cluster.nodes[number]
        if not names_after(BACK_S, lambda: by_kind(node.processes())["raylet"]):
            node.kill()

    def _head(self) -> list[psutil.Process]:
        return by_kind(self._cluster.nodes[0].processes())["gcs_server"]

    def _kill_head(self, command: Command, generator: random.Random) -> bool:
        """Kill the head: the command has to end by itself, with a message."""
        heads = self._head()
        if command.is_ending or not heads:
            return False
        heads[0].kill()
        try:
            code = command.process.wait(HEAD_S)
        except subprocess.TimeoutExpired:
            self._problems.append("expected the command to end after the death of the head, it did not")
            return True
        if code != 3:
            self._problems.append(f"expected exit code 3 after the death of the head, got {code}")
        if "continue with: robogauntlet resume" not in command.log.read_text():
            self._problems.append(f"expected a message about the death of the head; see {command.log}")
        return True


@contextlib.contextmanager
def three_nodes(folder: Path) -> Iterator[ThreeNodes]:
    """Three nodes, whose logs are in the folder."""
    with ray_cluster(folder) as cluster:
        yield ThreeNodes(cluster)
