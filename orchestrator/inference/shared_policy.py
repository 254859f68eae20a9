"""A policy that several connections ask. It computes in one thread, since policies are not thread-safe."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

from robogauntlet.orchestrator.inference.batcher import Batcher
from robogauntlet.orchestrator.inference.daemon_thread import DaemonThread
from robogauntlet.policies.contract import Decision, Policy, Query
from robogauntlet.policies.remote.msgpack_numpy import PackingError
from robogauntlet.policies.remote.protocol import greeting_of
from robogauntlet.suites.episode import Episode, Protocol, View

HORIZON = 1_000_000
"""Horizon of an episode that a client does not name."""


@dataclass(frozen=True)
class IdentifiedPolicy:
    """A policy with its name and the hash of its content."""

    policy: Policy
    name: str
    digest: str
    task: str = "unknown/unknown"
    """Task of clients that do not name one."""
    execute: int | None = None
    """Actions of a chunk that it asks to be executed, see `Wishes`."""


class SharedPolicy:
    """An identified policy, and who plays which of its episodes."""

    def __init__(self, served: IdentifiedPolicy, *, batch: int = 1, wait_s: float = 0.0) -> None:
        """Start its thread; the first query of a batch waits for others up to `wait_s`."""
        self.served = served
        self.greeting = greeting_of(served.policy, served.digest)
        self._thread = DaemonThread()
        wait_s = wait_s if batch > 1 else 0.0
        self.batcher = Batcher[Query, Decision](served.policy.act, self._thread, max_batch=batch, wait_s=wait_s)
        self._players: dict[str, object] = {}
        """Episode id to the connection that plays it."""
        self.unnamed: set[int] = set()
        """Seeds of the clients that do not name their episodes; a single client has 0."""

    def close(self) -> None:
        """End the policy's thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def own_episode(self, seed: int, replan_every: int, task: str | None = None) -> Episode:
        """Return the episode of a client that does not name it; `task` is None if it does not name that either."""
        served, spec = self.served, self.served.policy.spec
        view = View(spec.cameras or View().cameras, spec.image_size or View().image_size)
        protocol = Protocol(HORIZON, replan_every, view)
        return Episode(served.name, served.digest, task or served.task, seed, protocol)

    def free_episode(self, seed: int, replan_every: int, task: str | None) -> Episode:
        """Return the first such episode, from `seed` on, that nobody plays."""
        episodes = (self.own_episode(number, replan_every, task) for number in count(seed))
        return next(episode for episode in episodes if episode.id not in self._players)

    async def begin(self, player: object, episode: Episode) -> None:
        """Start an episode.

        Raises:
            PackingError: The policy has state, and another client plays the same episode.
        """
        other = self._players.get(episode.id)
        if self.greeting.remembers and other not in (None, player):
            raise PackingError(
                f"expected an episode of this client alone, got {episode.id}, which another client plays"
            )
        self._players[episode.id] = player
        try:
            await self._in_turn(self.served.policy.reset, [episode])
        except Exception:
            self._players.pop(episode.id, None)
            raise

    async def end(self, player: object, episodes: Sequence[Episode]) -> None:
        """Forget the player's episodes."""
        finished = [episode for episode in episodes if self._players.get(episode.id) is player]
        for episode in finished:
            del self._players[episode.id]
        if finished:
            await self._in_turn(self.served.policy.finish, finished)

    async def ask(self, query: Query) -> Decision:
        """Return the policy's answer, perhaps of a batch. Raises what the policy does."""
        (decision,) = await self.batcher.ask([query])
        return decision

    async def _in_turn(self, call: Any, episodes: Sequence[Episode]) -> None:
        await asyncio.get_running_loop().run_in_executor(self._thread, call, episodes)
