"""Helpers of the benchmarks."""

import os
from collections.abc import Iterator

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulation
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.suites.episode import Cell, Episode, Protocol, View

TASKS = ("maniskill/PushCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift")
"""One task of each simulator."""


def open_task(task: str, view: View) -> Simulation:
    """Open a task like a worker, with the environment variables of all simulators, as several share the process."""
    for simulator in catalog.simulators().values():
        os.environ.update(worker_environment(simulator))
    return catalog.open_simulation(task, view)


def episodes(task: str, policy: str, view: View, count: int, *, horizon: int = 40) -> Iterator[Episode]:
    """Episodes of equal length for a policy that never succeeds."""
    cell = Cell(policy, policy, task, Protocol(horizon, 8, view))
    return map(cell.episode, range(count))


def table(header: tuple[str, ...], rows: list[tuple[object, ...]]) -> None:
    """Print a table with aligned columns."""
    lines = [tuple(map(str, line)) for line in [header, *rows]]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip(), flush=True)
