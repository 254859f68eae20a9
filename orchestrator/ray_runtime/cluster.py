"""A Ray cluster that others started: whether its head answers, and which of its nodes can open a simulator."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any

from robogauntlet.adapters.contract import Simulator
from robogauntlet.support.secret_variables import without_secrets

if TYPE_CHECKING:
    from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver

RAY_PORT = 6379
"""Default port of a cluster's head."""
CONNECT_S = 10.0
"""Time for the head to answer before a run starts (s)."""
PROBE_S = 2.0
"""Time between two checks of the head, and for its answer (s)."""
ASK_S = 20.0
"""Time for another process to import Ray and have an answer of the head (s)."""
REFUSED, NO_HEAD = 7, 8
_ASK = f"""
import sys
from ray.exceptions import AuthenticationError
from robogauntlet.orchestrator.ray_runtime.private_names import private
if (client := private("_raylet", "GcsClient")) is None:  # Ray then says itself whether it can join
    sys.exit(0)
try:
    if sys.argv[1] == "auto":
        import ray

        ray.init("auto", log_to_driver=False, logging_level="ERROR")
    else:
        client(address=sys.argv[1])
except AuthenticationError:
    sys.exit({REFUSED})
except Exception:
    sys.exit({NO_HEAD})
"""
SILENCE_S = 20.0
"""Silence after which the head counts as dead (s). After 60 s Ray would end this process without a message of ours."""


class NoCluster(Exception):
    """There is no Ray cluster at the given address."""


def check_address(address: str) -> None:
    """Check `HOST:PORT` of a cluster's head, or `auto`, quickly, where Ray itself would wait for minutes.

    Raises:
        NoCluster: The address is invalid or does not answer.
    """
    if address == "auto":
        if _ask(address) == NO_HEAD:
            raise NoCluster("expected a Ray cluster that runs on this machine, found none; give HOST:PORT of its head")
        return
    host, _, port = address.rpartition(":")
    is_plain = ":" not in host or host.startswith("[")  # an address of IPv6 is in brackets
    if not host or "/" in host or not is_plain or not (port.isdecimal() and port.isascii() and 0 < int(port) < 2**16):
        raise NoCluster(f"expected HOST:PORT of a Ray cluster's head, such as 10.0.0.7:{RAY_PORT}, or auto")
    if (why := _connect(host.strip("[]"), int(port), CONNECT_S)) is not None:
        raise NoCluster(f"expected the head of a Ray cluster, nothing answers there: {why}")
    answer = _ask(address)
    if answer == NO_HEAD:
        raise NoCluster("expected the head of a Ray cluster, something else answers there")
    if answer == REFUSED:
        raise NoCluster(
            "expected the token of this Ray cluster, it refuses that of this process; set RAY_AUTH_MODE=token and "
            "RAY_AUTH_TOKEN"
        )


def _ask(address: str) -> int:
    """Return `REFUSED` if the head refuses the token of this process, `NO_HEAD` if nothing answers as a head does.

    Another process asks, as Ray logs the answer and waits for long.
    """
    asked, environment = [sys.executable, "-P", "-c", _ASK, address], without_secrets(os.environ)
    try:
        return subprocess.run(asked, capture_output=True, timeout=ASK_S, env=environment, check=False).returncode
    except subprocess.TimeoutExpired:
        return NO_HEAD


def _connect(host: str, port: int, timeout_s: float) -> str | None:
    """Why nothing answers at an address, or None."""
    try:
        socket.create_connection((host, port), timeout=timeout_s).close()
    except OSError as error:
        return error.strerror or str(error)
    return None


class ClusterHead:
    """The head of the cluster that this process has joined. While it is silent, most of Ray's calls do not return."""

    def __init__(
        self, address: str, now: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        """Watch the head at `HOST:PORT`."""
        self.address = address
        host, _, port = address.rpartition(":")
        self._host, self._port, self._now, self._sleep = host.strip("[]"), int(port), now, sleep
        self._heard = now()

    def wait_for_answer(self, *, after_s: float = 0.0) -> str | None:
        """Return None when the head answers, or what is wrong if it has been silent for `SILENCE_S`.

        It is not asked again within `after_s` of its latest answer (s).
        """
        if after_s and self._now() - self._heard < after_s:
            return None
        first = self._now()
        while (why := _connect(self._host, self._port, PROBE_S)) is not None:
            if self._now() - first >= SILENCE_S:
                return f"the head of the cluster at {self.address} has not answered for {SILENCE_S:g} s: {why}"
            self._sleep(PROBE_S / 4)
        self._heard = self._now()
        return None


class Placement:
    """Which nodes of the running Ray can open a simulator. Each node is asked once for each simulator."""

    def __init__(self, environments: EnvironmentResolver) -> None:
        """Use these environments."""
        self._environments = environments
        self._reasons: dict[tuple[str, str], str | None] = {}
        """Id of a node and simulator to why it cannot be opened there."""

    def nodes(self, simulator: Simulator) -> frozenset[str]:
        """Ids of the nodes on which a worker is placed, so that it can open the simulator.

        There are none if no node lacked it so far, so that the worker may wait for one that joins, and if none can:
        then the worker itself reports why. A node that lacked it may come back after it is lost, while the worker
        waits.
        """
        able = self.able(simulator)
        lacking = any(reason for (_, name), reason in self._reasons.items() if name == simulator.name)
        return frozenset(able if lacking else ())

    def able(self, simulator: Simulator) -> list[str]:
        """Ids of the living nodes that can open the simulator. A single node is not asked."""
        import ray

        nodes = [node["NodeID"] for node in ray.nodes() if node["Alive"]]
        if len(nodes) < 2 and not self._reasons:
            return nodes
        self._ask([node for node in nodes if (node, simulator.name) not in self._reasons], simulator)
        return [node for node in nodes if self._reasons[node, simulator.name] is None]

    def _ask(self, nodes: list[str], simulator: Simulator) -> None:
        import ray
        from ray.exceptions import RayError
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        asked: dict[str, Any] = {}
        task: Any = ray.remote(num_cpus=0, max_retries=0)(missing_reason)
        for node in nodes:
            strategy = NodeAffinitySchedulingStrategy(node, soft=False)
            asked[node] = task.options(scheduling_strategy=strategy).remote(self._environments, simulator.name)
        for node, answer in asked.items():
            try:
                self._reasons[node, simulator.name] = ray.get(answer)
            except RayError as error:  # the node died, or lacks this package
                self._reasons[node, simulator.name] = str(error)


def placed_on(nodes: Collection[str]) -> Mapping[str, Any]:
    """Options that put a Ray actor on one of these nodes; on any if there are none."""
    return {"label_selector": {"ray.io/node-id": f"in({','.join(sorted(nodes))})"}} if nodes else {}


def missing_reason(environments: EnvironmentResolver, simulator: str) -> str | None:
    """Why a simulator cannot be opened on this node, or None."""
    from robogauntlet.adapters import catalog

    return environments.missing_reason(catalog.find(simulator))
