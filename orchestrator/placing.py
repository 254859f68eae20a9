"""Which simulator a free place works for, where places are not tied to one. Pure, as `queue` is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

START_S = 20.0
"""About what it takes to start a worker, import its simulator and open a task: for less work than this left to each,
one worker more gains nothing."""


@dataclass(frozen=True)
class Demand:
    """What a simulator has to do."""

    waiting_s: float
    """Expected time of the episodes that nobody holds."""
    workers: int
    """Places at work on it."""


def most_needed(demands: Mapping[str, Demand]) -> str | None:
    """The simulator that a free place should work for, or None if it had better stay idle.

    One without any worker comes first, then the one with the most work left for each of its workers.
    """
    waiting = {name: demand for name, demand in demands.items() if demand.waiting_s > 0}
    if not waiting:
        return None
    name, most = max(waiting.items(), key=lambda item: (not item[1].workers, item[1].waiting_s / (1 + item[1].workers)))
    worth_it = not most.workers or most.waiting_s / (1 + most.workers) >= START_S
    return name if worth_it else None
