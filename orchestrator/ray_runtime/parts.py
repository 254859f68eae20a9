"""Which of its processes Ray starts, and how, by private names of it: there is no public interface."""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Iterable, Iterator
from typing import Any

from robogauntlet.orchestrator.ray_runtime import idle_agent, setup_worker

UNUSED = ("start_monitor", "start_log_monitor", "start_api_server")
"""How Ray starts its autoscaler, its log monitor and the server of its dashboard, which nothing here uses."""
_INTERPRETER = "_build_python_executable_command_memory_profileable"
"""Returns the first words of the command of a part that is written in Python."""
_AGENT = "dashboard_agent"
_SETUP = "SETUP_WORKER_FILENAME"
"""Name of the script that becomes a worker, in a folder of Ray's unless it is an absolute path. Ray's node knows it by
the name of its file, so ours has the same."""
_VERSION = "2.60."
"""The version of Ray whose agent and script can be replaced: others may need something else of them."""


@contextlib.contextmanager
def without_unused_parts() -> Iterator[None]:
    """Start only those processes of Ray that a session on one machine needs, and workers without importing Ray twice.

    Where Ray's dashboard is installed, it has its agent and its server, which the agent would look for every second.
    """
    import ray

    node, missing = private("node", "Node"), private("utils", "get_dashboard_dependency_error")
    has_dashboard = missing is None or missing() is None
    unused = UNUSED[:-1] if has_dashboard else UNUSED
    with contextlib.ExitStack() as stack:
        for name in unused:
            stack.enter_context(replaced(node, name, lambda *_, **__: None))
        is_known = ray.__version__.startswith(_VERSION)
        if is_known:
            stack.enter_context(replaced(private_module("ray_constants"), _SETUP, setup_worker.__file__))
        services = private_module("services")
        interpreter = getattr(services, _INTERPRETER, None)
        if interpreter is not None and not has_dashboard and is_known:

            def command(part: str, *arguments: Any, **options: Any) -> list[str]:
                if part == _AGENT:
                    return [sys.executable, "-I", "-S", idle_agent.__file__]
                words: list[str] = interpreter(part, *arguments, **options)
                return words

            stack.enter_context(replaced(services, _INTERPRETER, command))
        yield


@contextlib.contextmanager
def replaced(place: Any, name: str, value: Any) -> Iterator[None]:
    """Replace an attribute during the block, if there is one of that name; the place may be None."""
    if (before := getattr(place, name, None)) is None:
        yield
        return
    setattr(place, name, value)
    try:
        yield
    finally:
        setattr(place, name, before)


def private_module(name: str) -> Any:
    """A private module of Ray; None if this version of Ray lacks it."""
    try:
        return importlib.import_module(f"ray._private.{name}")
    except ImportError:
        return None


def private(module: str, name: str) -> Any:
    """A private name of Ray for which there is no public interface; None if this version of Ray lacks it."""
    return getattr(private_module(module), name, None)


class _NoFolders(list[str]):
    """A list to which nothing is added."""

    def extend(self, _: Iterable[str]) -> None:
        """Add nothing."""


def job_without_folders() -> Any:
    """What Ray is told about this process, without the folders of its script and its work.

    Workers would look for every module there first, before Python's own.
    """
    from ray.job_config import JobConfig

    job = JobConfig()
    job._py_driver_sys_path = _NoFolders()
    return job
