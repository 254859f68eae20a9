"""Messages between the scheduler and its workers. Imports no simulator, no policy, no Ray."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from robogauntlet.suites.episode import Cell, Episode


@dataclass(frozen=True)
class Lease:
    """Episodes of one cell that one worker plays in order."""

    cell: Cell
    seeds: tuple[int, ...]
    attempt: int = 1
    """Number of attempts at these episodes, including this one."""
    message_s: float = 0.1
    """Time between messages with results, so that short episodes share one; 0 sends each result separately."""

    def episodes(self) -> Iterator[Episode]:
        """The episodes, in order."""
        return map(self.cell.episode, self.seeds)


@dataclass(frozen=True)
class Readiness:
    """Properties of a simulator that a worker has opened."""

    pid: int
    render_device: str
    frame_s: float | None
    """Time of one warm observation by all cameras (s); None if the simulator does not render."""
