"""What a running suite tells those who watch: written about once a second, over what was said before."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

STALE_S = 60.0
"""A run that has said nothing for so long is taken for dead (s)."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True)


class LiveSimulator(_Model):
    """How far the episodes of one simulator are."""

    simulator: str
    planned: int
    successes: int
    failures: int
    errors: int
    per_minute: float | None = None
    """Episodes a minute of late."""
    left_s: float | None = None
    """Expected time left (s)."""

    @property
    def done(self) -> int:
        """Episodes with a row."""
        return self.successes + self.failures + self.errors


class LiveWorker(_Model):
    """What one worker does."""

    worker: str
    simulator: str
    doing: str
    """In words: "experts on robosuite/Lift, light 3" or "starting"."""
    since: float
    """Since when (seconds since 1970, UTC)."""


class Live(_Model):
    """A running suite at one moment."""

    at: float
    """When it was said (seconds since 1970, UTC)."""
    phase: str
    """What is done: "playing", "filming"."""
    simulators: tuple[LiveSimulator, ...] = ()
    workers: tuple[LiveWorker, ...] = ()
    says: tuple[str, ...] = ()
    """The last lines that the run printed."""
