"""Starts Ray on this machine or joins a cluster, and detects that Ray itself died."""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import signal
import sys
import tempfile
import threading
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import psutil

from robogauntlet.orchestrator.ray_runtime.cluster import PROBE_S, ClusterHead, check_address
from robogauntlet.orchestrator.ray_runtime.private_names import job_without_folders, private, quick_start, replaced
from robogauntlet.orchestrator.ray_runtime.session_folder import SessionFolder
from robogauntlet.support.errors import describe_os_error, first_line
from robogauntlet.support.interrupts import deferred_interrupts
from robogauntlet.support.secret_variables import SECRETS, playing_variables

_LOCAL_ENVIRONMENT: dict[str, str | None] = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # in spite of its name: one node only, on the loopback address
    "RAY_AUTH_MODE": "token",  # the default since Ray 2.60 only
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}
_PAST_THE_OBJECT_STORE = {"max_direct_call_object_size": 64 * 2**20, "task_rpc_inlined_bytes_limit": 2**40}
"""Send results directly: when the object store dies, Ray kills every process that reads from it without a message."""
_STARTED_HERE = {**_PAST_THE_OBJECT_STORE, "prestart_worker_first_driver": False}
"""Start no process ahead of work, one per core: a run may need fewer, or such with variables or Python of their own."""
WORKER_BYTES = 2 * 1024**3
"""Memory of a worker with a simulator, its renderer and a policy (bytes)."""
_JOINED_ENVIRONMENT: dict[str, str | None] = {
    f"RAY_{name}": str(value) for name, value in _PAST_THE_OBJECT_STORE.items()
}
"""The same for this process's part in a cluster that others started."""
_head: ClusterHead | None = None
"""The head of the cluster that this process has joined."""
_folder: SessionFolder | None = None
"""The folder of the Ray that was started here."""
_given: Mapping[str, str] = {}
"""The variables that its processes have from its start."""
_has_failed = False
"""Whether a Ray did not start here. The next one is started as it is, with all of its processes."""
_VITAL = ("raylet", "gcs_server")
_RESOURCES = (
    ("num_cpus", "CPU", "num_cpus", 1),
    ("num_gpus", "GPU", "num_gpus", 1),
    ("memory", "memory", "memory_gb", 1024**3),
)
"""Option of a Ray actor, Ray's resource, the suite's key, and its unit."""


class RayLost(Exception):
    """Ray itself died, and with it every worker."""


class NoRoom(Exception):
    """No node has a requested resource, so that Ray would wait forever."""


@contextlib.contextmanager
def ray_session(*, address: str | None, workers: int, variables: Mapping[str, str] | None = None) -> Iterator[None]:
    """Run Ray during the block. If this process has already started Ray, that is used and left running.

    Args:
        address: Cluster to join, or None to start Ray on this machine, reachable from this machine only.
        workers: Number of worker processes that must run at once. On one machine they share its cores if necessary.
        variables: Environment variables that all processes of a Ray started here have.

    Raises:
        NoCluster: Nothing answers at the address.
        RayLost: Ray could not be started on this machine.
    """
    global _head, _folder, _given
    if _has_ray():  # whose variables its further processes need
        yield
        return
    environment = _LOCAL_ENVIRONMENT if address is None else _JOINED_ENVIRONMENT
    with contextlib.ExitStack() as stack:
        stack.enter_context(_environment(environment))
        import_ray()
        if address is None and (config := private("_raylet", "Config")) is not None:
            config.initialize("")  # reads the variables again: Ray may have been imported before
        stack.enter_context(_on_loopback(address is None))
        import ray

        stack.enter_context(_silence())
        if address is not None:
            check_address(address)
        has_died = False
        try:
            if address is None:
                _folder = _new_folder()
                _given = {**playing_variables(os.environ), **(variables or {}), "TMPDIR": str(_folder.temporary)}
            _start(address, workers)
            if address is not None:
                _head = ClusterHead(ray.get_runtime_context().gcs_address)
            yield
            has_died = bool(_dead_parts())
        except RayLost:
            has_died = True
            raise
        finally:
            folder, _head, _folder, _given = _folder, None, None, {}
            try:
                ray.shutdown()
            finally:
                if folder is not None:
                    folder.remove(logs=not has_died)


def _has_ray() -> bool:
    """Whether this process has started Ray or joined a cluster."""
    ray = sys.modules.get("ray")
    return ray is not None and ray.is_initialized()


def import_ray() -> None:
    """Import Ray as a whole: the start of its compiled modules drops an interruption without a word."""
    with deferred_interrupts():
        import ray  # noqa: F401


@contextlib.contextmanager
def _environment(variables: Mapping[str, str | None]) -> Iterator[None]:
    """Set or remove variables during the block: later, they would apply to any other Ray of this process."""
    before = {name: os.environ.get(name) for name in variables}
    _set_environment(variables)
    try:
        yield
    finally:
        _set_environment(before)


def _hidden() -> dict[str, None]:
    """The variables without which Ray is started: its processes hand theirs on to every worker."""
    return dict.fromkeys(os.environ.keys() - playing_variables(os.environ).keys())


def _set_environment(variables: Mapping[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@contextlib.contextmanager
def _on_loopback(applies: bool) -> Iterator[None]:
    """Give Ray the loopback address during the block: it read the environment variable when it was first imported."""
    with replaced("_private.ray_constants", "ENABLE_RAY_CLUSTER", False) if applies else contextlib.nullcontext():
        yield


def _start(address: str | None, workers: int) -> None:
    """Start Ray on this machine, or join the cluster at the address, without Ray's messages and signal handlers."""
    global _has_failed
    import ray

    logging.getLogger("ray").setLevel(logging.ERROR)
    on_terminate = signal.getsignal(signal.SIGTERM)
    with contextlib.suppress(OSError, RuntimeError):  # no home: Ray says so itself
        keep_token(Path.home() / ".ray")
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    options |= {"job_config": job_without_folders()}
    if address is None:
        cores = max(os.cpu_count() or 1, workers)
        options |= {"num_cpus": cores, "include_dashboard": False, "_system_config": _STARTED_HERE}
        options |= {"_temp_dir": str(_folder.ray)} if _folder is not None else {}
    children = set(psutil.Process().children(recursive=True))
    try:
        with (
            _environment({**_hidden(), **_given} if address is None else {}),
            # Its own handlers exit with another code, and would be in force for the seconds of the start.
            replaced("_private.utils", "set_sigterm_handler", lambda _: None),
            quick_start() if address is None and not _has_failed else contextlib.nullcontext(),
        ):
            ray.init(address or "local", **options)
    except BaseException as error:  # Ray raises no narrower one when its processes take longer than 30 s to start
        if address is not None:
            raise
        _has_failed = True
        _end_children(but=children)  # at an interruption, too: Ray's agents would live for a minute
        if not isinstance(error, Exception):
            raise
        raise RayLost(f"Ray did not start: {first_line(error)}") from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, on_terminate)  # if this version of Ray set its own


def keep_token(folder: Path) -> None:
    """Make this user's token for Ray, for its owner only, unless there is one.

    Ray itself writes it in place, readable for all: of two that start at once on a new machine, one would go on with a
    token that its further processes do not find.

    Raises:
        OSError: It cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    token = folder / "auth_token"
    with tempfile.NamedTemporaryFile("w", dir=folder) as new:  # with mode 0600
        new.write(secrets.token_hex(32))
        new.flush()
        with contextlib.suppress(FileExistsError):
            os.link(new.name, token)
    token.chmod(0o600)


def _new_folder() -> SessionFolder:
    try:
        return SessionFolder()
    except OSError as error:
        raise RayLost(f"Ray did not start: {describe_os_error(error)}") from None


def _end_children(but: Collection[psutil.Process]) -> None:
    """End the processes that Ray started before its start failed: Ray itself does so only when this process ends.

    Only this process's own children are waited for. The others are killed too, but it is up to the system when it
    removes them: in a container the first process may take seconds, or never do so.
    """
    process = psutil.Process()
    own, started = process.children(), process.children(recursive=True)
    for child in started:
        if child not in but:
            with contextlib.suppress(psutil.NoSuchProcess):
                child.kill()
    psutil.wait_procs([child for child in own if child not in but])


def room_for_workers() -> int:
    """Number of workers for which the running Ray has cores and memory.

    Raises:
        RayLost: Ray itself has died.
    """
    import ray

    check_alive(after_s=0.0)
    resources = ray.cluster_resources()
    cores = int(resources.get("CPU", 1))
    return max(1, min(cores, int(resources.get("memory", cores * WORKER_BYTES) // WORKER_BYTES)))


def check_room(key: str, options: Mapping[str, float]) -> None:
    """Refuse options of a Ray actor that no node satisfies, for which Ray would wait forever.

    The options are `num_cpus`, `num_gpus` and `memory` (bytes); the message names them by the suite's `key`.

    Raises:
        NoRoom: No node has these resources.
    """
    import ray

    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    for option, resource, name, unit in _RESOURCES:
        available = max((node.get(resource, 0.0) for node in nodes), default=0.0)
        if options.get(option, 0.0) > available:
            raise NoRoom(
                f"{key}.{name}: expected at most what one node has, {available / unit:g}; "
                f"got {options[option] / unit:g}"
            )


def workers_that_fit(free: Mapping[str, float], options: Mapping[str, float]) -> int:
    """Number of Ray actors with these options, of which one at least is not 0, that fit into a node's resources.

    Rests of several GPUs count together, although an actor must find its share on one.
    """
    needed = {resource: options[option] for option, resource, *_ in _RESOURCES if options.get(option)}
    return min(int(free.get(resource, 0.0) // amount) for resource, amount in needed.items())


def check_alive(*, after_s: float = PROBE_S) -> None:
    """Check that Ray can be called: its own calls would wait forever.

    The head of a joined cluster is not asked again within `after_s` of its latest answer (s). While it does not
    answer, this waits.

    Raises:
        RayLost: A process of the Ray started here has died, or the head of the cluster does not answer.
    """
    for kind, status in _dead_parts().items():
        raise RayLost(f"Ray's {kind} died (exit status {status})")
    if _head is not None and (silence := _head.wait_for_answer(after_s=after_s)):
        raise RayLost(silence)


def temporary_folder() -> Path | None:
    """Where processes of the session keep temporary files, so that none are left; None for the system's folder."""
    return None if _folder is None else _folder.temporary


def in_session(runtime_env: Mapping[str, Any]) -> dict[str, Any]:
    """A `runtime_env` of Ray whose processes have no secrets, and keep temporary files in the session's folder.

    The Ray that was started here has no secrets and gives its processes that folder; another hands its own secrets on.
    A process without a `runtime_env` starts sooner: where Ray sets one up, Python starts twice.
    """
    more = dict.fromkeys(SECRETS, "") if _folder is None else {}
    variables = {name: value for name, value in runtime_env["env_vars"].items() if _given.get(name) != value}
    return {**runtime_env, "env_vars": more | variables} if more or variables or len(runtime_env) > 1 else {}


def _dead_parts() -> dict[str, int]:
    """The vital processes of the Ray started here that have died, with their exit status."""
    node = private("_private.worker", "_global_node")
    return {kind: process.returncode for kind, process in (node.dead_processes() if node else ()) if kind in _VITAL}


def answer(reference: Any) -> Any:
    """Like `ray.get`, but does not wait forever if Ray itself died.

    Raises:
        RayLost: Ray itself has died.
        RayError: The task failed.
    """
    import ray
    from ray.exceptions import GetTimeoutError

    while True:
        try:
            return ray.get(reference, timeout=1.0)
        except GetTimeoutError:
            check_alive()


def free_resources() -> Mapping[str, Mapping[str, float]]:
    """What is free on each node, by its id; all that it has where Ray does not say what is free."""
    import ray

    if (of_nodes := private("_private.state", "available_resources_per_node")) is not None:
        free: Mapping[str, Mapping[str, float]] = of_nodes()
        return free
    return {node["NodeID"]: node["Resources"] for node in ray.nodes() if node["Alive"]}


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep Ray's long messages about dead workers and nodes out of the display; the scheduler reports them."""
    with replaced("_private.worker", "print_to_stdstream", lambda *_, **__: None):
        yield
