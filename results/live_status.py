"""The live status of a run: progress, activity of workers, last messages. Written about once a second."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

STALE_S = 60.0
"""Time without a new status after which a run is considered dead (s)."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True)


class LiveSimulator(_Model):
    """Progress of one simulator."""

    simulator: str
    planned: int
    successes: int
    failures: int
    errors: int
    per_minute: float | None = None
    """Recent episodes per minute."""

    @property
    def done(self) -> int:
        """Episodes with a row."""
        return self.successes + self.failures + self.errors


class LiveWorker(_Model):
    """Activity of one worker."""

    worker: str
    simulator: str
    activity: str
    """Such as "experts on robosuite/Lift, light 3" or "starting"."""
    since: float
    """Start of the activity (seconds since 1970, UTC)."""


class LiveStatus(_Model):
    """Status of a run at one moment."""

    at: float
    """Time of the status (seconds since 1970, UTC)."""
    phase: str
    """The current phase, such as "playing"."""
    simulators: tuple[LiveSimulator, ...] = ()
    left_s: tuple[float, float] | None = None
    """The shortest and longest time that is expected to be left (s); None before that can be told."""
    workers: tuple[LiveWorker, ...] = ()
    messages: tuple[str, ...] = ()
    """The last lines that the run printed."""
