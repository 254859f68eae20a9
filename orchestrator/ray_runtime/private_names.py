"""Private names of Ray, where it has no public ones. Whoever uses one does without it where Ray lacks it."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

NODE_S = 10.0
"""Time to look for Ray's node before Ray itself does (s)."""


def private_module(name: str) -> Any:
    """A private module of Ray, such as `_private.utils`; None if this version of Ray lacks it."""
    try:
        return importlib.import_module(f"ray.{name}")
    except ImportError:
        return None


def private(module: str, name: str) -> Any:
    """A name of a private module of Ray; None if this version of Ray lacks it."""
    return getattr(private_module(module), name, None)


@contextlib.contextmanager
def replaced(module: str, name: str, value: Any) -> Iterator[None]:
    """Replace a name of a private module of Ray during the block, if this version of Ray has it."""
    if (before := private(module, name)) is None:
        yield
        return
    place = private_module(module)
    setattr(place, name, value)
    try:
        yield
    finally:
        setattr(place, name, before)


@contextlib.contextmanager
def quick_start() -> Iterator[None]:
    """Let `ray.init` start no autoscaler, monitor of logs and API server during the block: nothing here uses them.

    The first two are parameters of Ray that `ray.init` does not offer, and the third may be missing: Ray goes on where
    it does not start. What has another name in a version of Ray is started. Ray looks once a second whether its node
    is there, which takes a fraction of one; here it looks first when it is.
    """
    parameters = private("_private.parameter", "RayParams")
    fewer = {"no_monitor": True, "include_log_monitor": False}
    if parameters is not None and fewer.keys() <= inspect.signature(parameters).parameters.keys():
        parameters = partial(parameters, **fewer)
    with (
        replaced("_private.parameter", "RayParams", parameters),
        replaced("_private.services", "start_api_server", lambda *_, **__: (None, None)),
        replaced("_private.services", "get_node", partial(_get_node, private("_private.services", "get_node"))),
    ):
        yield


def _get_node(get_node: Callable[..., Any], gcs_address: str, node_id: str) -> Any:
    """What `get_node` returns, called when the node is there, or after `NODE_S`."""
    with contextlib.suppress(Exception):  # whatever has another name
        state, end = private("_private.state", "GlobalState")(), time.monotonic() + NODE_S
        state._initialize_global_state(private("_private.services", "_get_gcs_client_options")(gcs_address))
        while time.monotonic() < end and all(node["NodeID"] != node_id for node in state.node_table()):
            time.sleep(0.02)
        state.disconnect()
    return get_node(gcs_address, node_id)


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
