"""The environment of a process that runs a simulator."""

from __future__ import annotations

import os

from adapters.contract import Simulator

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def worker_environment(simulator: Simulator) -> dict[str, str]:
    """Environment variables to set: one thread, and what the simulator asks for unless the user has set it."""
    wanted = {name: value for name, value in simulator.environment.items() if name not in os.environ}
    return {**_ONE_THREAD, **wanted}
