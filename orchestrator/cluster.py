"""Starts Ray on this machine, or joins a cluster."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator

_LOCAL_ENVIRONMENT = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # in spite of its name: one node only, on the loopback address
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}


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
    if address is None:
        cores = max(os.cpu_count() or 1, workers)
        ray.init(num_cpus=cores, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    else:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    _silence_raylet()
    try:
        yield
    finally:
        ray.shutdown()


def _silence_raylet() -> None:
    """Keep Ray's long messages about dead workers out of the progress display; the scheduler says it in a line."""
    with contextlib.suppress(ImportError, AttributeError, KeyError):
        from ray._private.ray_logging import global_worker_stdstream_dispatcher

        global_worker_stdstream_dispatcher.remove_handler("ray_print_logs")
