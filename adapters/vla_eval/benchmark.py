"""What is declared of a benchmark of vla-evaluation-harness."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from robogauntlet.adapters.contract import ActionSpec, Number
from robogauntlet.suites.episode import CAMERAS


@dataclass(frozen=True)
class Part:
    """Some numbers of an action, such as a position: a `DimSpec` of the class, in its unit."""

    size: int
    low: float = -math.inf
    high: float = math.inf
    still: float = 0.0
    """With which they move nothing."""


@dataclass(frozen=True)
class Benchmark:
    """A class of the harness, and what its tasks have in common."""

    path: str
    """`MODULE:CLASS`, a `StepBenchmark`."""
    action: Mapping[str, Part]
    """The parts of an action by name, in their order."""
    cameras: Mapping[str, str]
    """Camera here to the name of the image there."""
    control_hz: float
    """Control steps per simulated second."""
    state: Mapping[str, int] = field(default_factory=dict)
    """Keys of the observation, each with the number of its values, that are proprioception."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Of the class."""
    own_words: bool = False
    """Whether the class says the goal in other words in each episode."""

    def __post_init__(self) -> None:
        """Check it. Raises ValueError for a path without a class, other cameras, or an action without numbers."""
        if not re.fullmatch(r"[\w.]+:\w+", self.path):
            raise ValueError(f"benchmark: expected MODULE:CLASS, got {self.path!r}")
        if CAMERAS[0] not in self.cameras or set(self.cameras) - set(CAMERAS):
            given = ", ".join(self.cameras) or "none"
            raise ValueError(f"cameras: expected {CAMERAS[0]} and perhaps {CAMERAS[1]}, got {given}")
        if sizes := [f"{size} in '{key}'" for key, size in self._sizes() if size < 1]:
            raise ValueError(f"action, state: expected 1 number or more in each part, got {sizes[0]}")
        if not self.action:
            raise ValueError("action: expected a part or more, got none")

    def _sizes(self) -> list[tuple[str, int]]:
        return [*((key, part.size) for key, part in self.action.items()), *self.state.items()]

    @property
    def action_spec(self) -> ActionSpec:
        """The numbers of an action, and the names of those of proprioception."""
        numbers = [
            Number(name, part.low, part.high) for key, part in self.action.items() for name in _names(key, part.size)
        ]
        state = [name for key, size in self.state.items() for name in _names(key, size)]
        return ActionSpec(0.0, 0.0, self.control_hz, numbers=tuple(numbers), state=tuple(state))


def _names(key: str, size: int) -> list[str]:
    return [key] if size == 1 else [f"{key}_{number}" for number in range(1, size + 1)]
