"""Starts Ray on this machine, or joins a cluster, and notices when Ray itself dies."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import threading
from collections.abc import Iterator, Mapping
from typing import Any

_LOCAL_ENVIRONMENT = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # in spite of its name: one node only, on the loopback address
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}
_PAST_THE_OBJECT_STORE = {"max_direct_call_object_size": 64 * 2**20, "task_rpc_inlined_bytes_limit": 2**40}
"""Results come straight to us: Ray ends a process that reads from the object store when that dies, without a word."""
WORKER_BYTES = 2 * 1024**3
"""Memory that a worker may come to need: a simulator, its renderer and a policy."""
RAY_PORT = 6379
"""Where the head of a cluster listens if nobody says otherwise."""
CONNECT_S = 10.0
_VITAL = ("raylet", "gcs_server")
_ASKED = (
    ("num_cpus", "CPU", "num_cpus", 1),
    ("num_gpus", "GPU", "num_gpus", 1),
    ("memory", "memory", "memory_gb", 1024**3),
)
"""Option of a Ray actor, Ray's resource, the suite's key, and its unit."""


class RayLost(Exception):
    """Ray itself has died, and with it every worker."""


class NoCluster(Exception):
    """There is no Ray cluster at the address that was given."""


class NoRoom(Exception):
    """Something is asked of Ray that no node has, so that it would wait without end."""


def check_address(address: str) -> None:
    """Refuse an address that Ray would fail on, or wait minutes for.

    Args:
        address: `HOST:PORT` of a cluster's head, or `auto` for one that runs on this machine.

    Raises:
        NoCluster: It is neither, or nothing listens there.
    """
    if address == "auto":
        return
    host, _, port = address.rpartition(":")
    if not host or "/" in host or not (port.isdecimal() and 0 < int(port) < 2**16):
        raise NoCluster(f"expected HOST:PORT of a Ray cluster's head, such as 10.0.0.7:{RAY_PORT}, or auto")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_S).close()
    except OSError as error:
        why = error.strerror or str(error)
        raise NoCluster(f"expected the head of a Ray cluster, nothing answers there: {why}") from None


@contextlib.contextmanager
def ray_session(*, address: str | None, workers: int) -> Iterator[None]:
    """Ray, for the duration of the block. One that this process has started already is used and left running.

    Args:
        address: Of a cluster to join, or None to start Ray on this machine, reachable from this machine only.
        workers: Worker processes that must fit beside each other. On one machine they share its cores if need be.
    """
    if address is None:
        for name, value in _LOCAL_ENVIRONMENT.items():
            os.environ.setdefault(name, value)
    import ray

    if ray.is_initialized():
        yield
        return
    logging.getLogger("ray").setLevel(logging.ERROR)
    on_terminate = signal.getsignal(signal.SIGTERM)
    if address is None:
        cores = max(os.cpu_count() or 1, workers)
        ray.init(
            "local",
            num_cpus=cores,
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            _system_config=_PAST_THE_OBJECT_STORE,
        )
    else:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, on_terminate)  # Ray puts its own handler there, which exits at once
    _silence_raylet()
    try:
        yield
    finally:
        ray.shutdown()


def room_for_workers() -> int:
    """How many workers fit the cores and the memory of the Ray that is running."""
    import ray

    resources = ray.cluster_resources()
    cores = int(resources.get("CPU", 1))
    return max(1, min(cores, int(resources.get("memory", cores * WORKER_BYTES) // WORKER_BYTES)))


def check_room(key: str, asked: Mapping[str, float]) -> None:
    """Refuse what Ray would wait for without end.

    Args:
        key: Of the suite, under which it is asked for.
        asked: Options of a Ray actor: `num_cpus`, `num_gpus`, `memory` (bytes).

    Raises:
        NoRoom: No node has as much.
    """
    import ray

    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    for option, resource, name, unit in _ASKED:
        most = max((node.get(resource, 0.0) for node in nodes), default=0.0)
        if asked.get(option, 0.0) > most:
            raise NoRoom(
                f"{key}.{name}: expected at most what one node has, {most / unit:g}; got {asked[option] / unit:g}"
            )


def check_alive() -> None:
    """Notice that a part of the Ray that this process started has died. Ray's own calls would wait for it for ever.

    Raises:
        RayLost: It has.
    """
    from ray._private import worker  # Ray offers no public way to ask

    node: Any = worker._global_node
    for kind, process in node.dead_processes() if node else ():
        if kind in _VITAL:
            raise RayLost(f"Ray's {kind} died (exit status {process.returncode})")


def answer(reference: Any) -> Any:
    """`ray.get` that does not wait for a Ray that has died.

    Raises:
        RayLost: It has.
        RayError: The task failed.
    """
    import ray
    from ray.exceptions import GetTimeoutError

    while True:
        try:
            return ray.get(reference, timeout=1.0)
        except GetTimeoutError:
            check_alive()


def _silence_raylet() -> None:
    """Keep Ray's long messages about dead workers out of the progress display; the scheduler says it in a line."""
    with contextlib.suppress(ImportError, AttributeError, KeyError):
        from ray._private.ray_logging import global_worker_stdstream_dispatcher

        global_worker_stdstream_dispatcher.remove_handler("ray_print_logs")
