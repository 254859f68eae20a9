"""How the learning rate goes."""

from __future__ import annotations

import math
from enum import StrEnum


class Schedule(StrEnum):
    """What follows the warm-up."""

    COSINE = "cosine"
    """Half a cosine down to zero (arXiv 1608.03983, without restarts)."""
    CONSTANT = "constant"
    """As the paper's released code in effect does."""


def rate_at(step: int, *, steps: int, warm_up: int, schedule: Schedule) -> float:
    """Share of the full learning rate in a step, counted from 0; the warm-up rises linearly."""
    if step < warm_up:
        return (step + 1) / (warm_up + 1)
    if schedule is Schedule.CONSTANT:
        return 1.0
    done = (step - warm_up) / max(steps - warm_up, 1)
    return 0.5 * (1.0 + math.cos(math.pi * done))
