"""A connection in openpi's protocol: metadata first, then a chunk for each observation, or a line of text."""

from __future__ import annotations

import time
from itertools import count
from typing import Any

from robogauntlet.orchestrator.inference.session import Session
from robogauntlet.orchestrator.inference.shared_policy import SharedPolicy
from robogauntlet.policies.contract import Decision, check_chunk
from robogauntlet.policies.remote.msgpack_numpy import PackingError, pack
from robogauntlet.policies.remote.protocol import as_answer, as_metadata, episode_in, finished_in, query_in
from robogauntlet.suites.episode import Episode

MAX_EPISODES = 1024
"""Maximum number of simultaneous episodes of one client."""


class OpenpiSession(Session):
    """The state of one connection."""

    def __init__(self, policy: SharedPolicy) -> None:
        """A connection without an episode."""
        super().__init__(policy)
        self._step = 0
        """Number of actions sent to a client that does not name its episode and step."""
        self._seed: int | None = None

    def greeting(self) -> bytes:
        """Return the metadata."""
        return pack(as_metadata(self._policy.greeting) | {"policy": self._policy.served.name})

    async def decide(self, message: dict[str, Any]) -> bytes:
        """Return a packed chunk."""
        policy, named = self._policy, episode_in(message)
        finished = [self._episodes.pop(name) for name in finished_in(message) if name in self._episodes]
        if finished:
            await policy.end(self, finished)
        episode, step = named or (self._unnamed(), self._step)
        query = query_in(message, episode, step, policy.served.policy.spec)
        if episode.id not in self._episodes or (named and not step):
            if step and policy.greeting.remembers:
                raise PackingError(f"expected an episode from its first step on, got step {step} of one not begun here")
            if len(self._episodes) >= MAX_EPISODES:
                raise PackingError(f"expected {MAX_EPISODES} episodes of one client at most, got one more")
            await policy.begin(self, episode)
            self._episodes[episode.id] = episode
        start = time.perf_counter()
        decision = await policy.ask(query)
        chunk = check_chunk(decision.actions, query.action_dim)
        if named is None:
            self._step += len(chunk)
        answer = as_answer(Decision(chunk, decision.routing))
        return pack(answer | {"server_timing": {"infer_ms": 1000 * (time.perf_counter() - start)}})

    def refusal(self, line: str, message: dict[str, Any]) -> str:
        """Return the line, which is a text frame."""
        return line

    async def leave(self) -> None:
        """Forget the client's episodes and seed."""
        if self._seed is not None:
            self._policy.unnamed.discard(self._seed)
        await super().leave()

    def _unnamed(self) -> Episode:
        taken = self._policy.unnamed
        if self._seed is None:
            self._seed = next(seed for seed in count() if seed not in taken)
            taken.add(self._seed)
        return self._policy.own_episode(self._seed, self._policy.served.policy.spec.chunk_length)
