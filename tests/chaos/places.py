"""Where campaigns run a command, and which faults they cause there: one machine, or a Ray cluster of three nodes."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from tests.chaos.cluster_nodes import Node, RayCluster, ray_cluster
from tests.chaos.processes import MARK, by_kind, end, marked, names_after

GONE_S = 60.0
"""Time for all processes to end (s). A worker whose raylet is killed while it starts searches for it for 26 s (measured
with Ray 2.60) before it ends."""
LOCK_S = 3.0
POWER_CUT_S = 10.0
"""Time until a node that was killed is started again (s)."""
CUT_OFF_S = (30.0, 60.0)
"""Shortest and longest time that a node is cut off from the network (s)."""
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
    problems: list[str] = field(default_factory=list)
    """Violated expectations that a fault has noticed."""


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

    def end(self) -> None:
        """Kill all processes of the command."""
        end(self.mark)

    def _of_command(self) -> list[psutil.Process]:
        return marked(self.mark)

    def _arguments(self, suite: Path, folder: Path) -> list[str]:
        return [sys.executable, "-c", PROGRAM, "run", str(suite), "--out", str(folder), "--no-media"]


class ThreeNodes(OneMachine):
    """A Ray cluster of three nodes; the command runs on the first, which has the head."""

    def __init__(self, cluster: RayCluster) -> None:
        super().__init__()
        self._cluster = cluster
        self.faults = {
            **_EVERYWHERE,
            "node killed": self._kill_node,
            "node cut off": self._cut_node_off,
            "head killed": self._kill_head,
        }

    def processes(self) -> list[psutil.Process]:
        """All processes that a fault may hit."""
        return [process for node in self._cluster.nodes for process in node.processes()]

    def start(self, suite: Path, folder: Path, log: Path) -> Command:
        """Start to play a suite, or continue; before, start Ray on every node that lacks it."""
        self._start_ray()
        arguments = [*self._arguments(suite, folder), "--address", self._cluster.address]
        process = self._cluster.popen(0, arguments, log, {MARK: self.mark})
        nsenter = psutil.Process(process.pid)
        while not nsenter.children():
            time.sleep(0.01)
        return Command(process, nsenter.children()[0], folder, log, self)

    def _of_command(self) -> list[psutil.Process]:
        return [*marked(self.mark), *by_kind(self.processes())["worker"]]

    def _start_ray(self) -> None:
        nodes = self._cluster.nodes
        if not by_kind(nodes[0].processes())["gcs_server"]:
            for node in nodes:
                node.kill()
            self._cluster.start_ray(0)
        lacking = [number for number, node in enumerate(nodes) if not by_kind(node.processes())["raylet"]]
        with ThreadPoolExecutor() as pool:
            list(pool.map(self._cluster.start_ray, lacking))

    def _kill_node(self, command: Command, generator: random.Random) -> bool:
        """Let a node lose its power, which sends no last word to the others, and start it again."""
        number, node = self._another(generator)
        self._cluster.cut(number, off=True)
        node.kill()
        time.sleep(POWER_CUT_S)
        self._cluster.cut(number, off=False)
        self._cluster.start_ray(number)
        return True

    def _cut_node_off(self, command: Command, generator: random.Random) -> bool:
        """Cut a node off from the network for a time; then start it again, as a supervisor does."""
        number, node = self._another(generator)
        self._cluster.cut(number, off=True)
        time.sleep(generator.uniform(*CUT_OFF_S))
        self._cluster.cut(number, off=False)
        node.kill()
        self._cluster.start_ray(number)
        return True

    def _another(self, generator: random.Random) -> tuple[int, Node]:
        """A node that has neither the head nor the command."""
        return generator.choice(list(enumerate(self._cluster.nodes))[1:])

    def _kill_head(self, command: Command, generator: random.Random) -> bool:
        """Kill the head: the command has to end by itself, with a message."""
        heads = by_kind(self._cluster.nodes[0].processes())["gcs_server"]
        if command.is_ending or not heads:
            return False
        heads[0].kill()
        try:
            code = command.process.wait(HEAD_S)
        except subprocess.TimeoutExpired:
            command.problems.append("expected the command to end after the death of the head, it did not")
            return True
        if code != 3:
            command.problems.append(f"expected exit code 3 after the death of the head, got {code}")
        if "continue with: robogauntlet run" not in command.log.read_text():
            command.problems.append(f"expected a message about the death of the head; see {command.log}")
        return True


@contextlib.contextmanager
def three_nodes(folder: Path) -> Iterator[ThreeNodes]:
    """Three nodes, whose logs are in the folder."""
    with ray_cluster(folder) as cluster:
        yield ThreeNodes(cluster)
