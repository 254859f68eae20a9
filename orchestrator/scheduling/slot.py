"""A place for one worker of a scheduler."""

from __future__ import annotations

from dataclasses import dataclass, field

from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.scheduling import worker_pool
from robogauntlet.results.live_status import LiveWorker

ROOM_S = 15.0
"""Time that a worker may wait for room before another that would find some takes its place (s)."""


@dataclass
class Slot:
    """A place for one worker. It gets a new worker when the old one dies."""

    simulator: str
    """Empty if the slot may serve any simulator and has not chosen one yet."""
    number: int
    bound: bool = True
    """Whether it always serves the same simulator."""
    worker: worker_pool.Worker | None = None
    running: bool = False
    """Whether its worker has a process; before, Ray may still search for a node."""
    lease: Lease | None = None
    finished: int = 0
    """Episodes of the lease that are finished."""
    last_event_at: float = 0.0
    activity_began: float = 0.0
    open_task: str | None = None
    loaded: set[str] = field(default_factory=set)
    """Policies that its worker has loaded."""
    played: int = 0
    memory_bytes: int = 0
    opening: str = ""
    """The task that its worker opens at its start."""
    started_at: float = 0.0
    """Start of its worker."""
    patience_s: float = ROOM_S
    """`ROOM_S`, doubled with each worker that was ended after it: a slow start cannot be told from waiting for room."""
    next_simulator: str = ""
    """The simulator that it serves next, if that is already chosen."""

    @property
    def name(self) -> str:
        """Name of its workers."""
        return f"{self.simulator}-{self.number}"

    def waits_for_room(self, now: float) -> bool:
        """Whether its worker has had no process for longer than its patience."""
        return self.worker is not None and not self.running and now - self.activity_began > self.patience_s

    def activity(self, since: float) -> LiveWorker:
        """What its worker has been doing since this time (seconds since 1970)."""
        text = "starts" if self.worker is not None and self.open_task is None else "waits"
        if self.lease is not None:
            cell, seeds = self.lease.cell, self.lease.seeds
            text = f"{cell.policy} on {cell.task}, {cell.condition}, episode {self.finished + 1} of {len(seeds)}"
        return LiveWorker(worker=self.name, simulator=self.simulator, activity=text, since=since)
