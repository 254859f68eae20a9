"""Answers that take long: a cache of them, and a limit to how many are computed and waited for."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

from anyio import CapacityLimiter, to_thread
from cachetools import TTLCache
from fastapi import HTTPException

WAITING = 5
"""Slow answers that may wait to be computed."""
PATIENCE_S = 0.2
"""How long a page waits for an answer if it can show an earlier one (s)."""
RETRY_S = 10
"""Time after which a refused client may ask again (s)."""
K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class AnswerCache(Generic[K, V]):
    """A thread-safe cache of the most recently used answers; simultaneous requests compute an answer once."""

    def __init__(self, size: int, seconds: float = float("inf")) -> None:
        """Keep up to `size` answers, each for `seconds`."""
        self._answers: TTLCache[K, V] = TTLCache(size, seconds)
        self._lock, self._computing = threading.Lock(), threading.Lock()

    def get(self, key: K, compute: Callable[[], V]) -> V:
        """Return the answer for a key; compute it if it is not cached. Exceptions are raised and not cached."""
        if (answer := self.cached(key)) is not None:
            return answer
        with self._computing:  # one at a time, since answers need memory
            if (answer := self.cached(key)) is not None:
                return answer
            return self._keep(key, compute())

    def renew(self, key: K, compute: Callable[[], V]) -> V:
        """Compute the answer for a key, whether it is cached or not. Exceptions are raised and the cache unchanged."""
        with self._computing:
            return self._keep(key, compute())

    def _keep(self, key: K, answer: V) -> V:
        with self._lock:
            self._answers[key] = answer
        return answer

    def cached(self, key: K) -> V | None:
        """Return the answer for a key if it is cached."""
        with self._lock:
            return self._answers.get(key)


class SlowWork:
    """Computes slow answers in threads of its own, so that other requests never wait for them. For one event loop."""

    def __init__(self, at_once: int, waiting: int) -> None:
        """Compute `at_once` answers at a time; refuse others while `waiting` wait."""
        self._limiter, self._most = CapacityLimiter(at_once), at_once + waiting
        self._tasks: dict[Hashable, asyncio.Task[Any]] = {}

    async def answer(self, cache: AnswerCache[K, V], key: K, compute: Callable[[], V]) -> V:
        """Return the answer for a key from the cache, or compute it. Raises what `compute` and `run` raise."""
        found = cache.cached(key)
        return found if found is not None else await self.run((id(cache), key), lambda: cache.get(key, compute))

    async def latest(
        self, cache: AnswerCache[K, tuple[Hashable, V]], key: K, version: Hashable, compute: Callable[[], V]
    ) -> tuple[V, bool]:
        """Return the answer for a version of what the key names, and whether it is of this version.

        It is an earlier one if this one takes longer than `PATIENCE_S` or cannot be waited for; the cache is renewed
        meanwhile. Raises what `compute` raises and, without an earlier one, what `run` raises.
        """
        known = cache.cached(key)
        if known is not None and known[0] == version:
            return known[1], True
        try:
            async with asyncio.timeout(None if known is None else PATIENCE_S):
                known = await self.run((id(cache), key), lambda: cache.renew(key, lambda: (version, compute())))
        except (TimeoutError, HTTPException):
            if known is None:
                raise
        return known[1], known[0] == version

    async def run(self, key: Hashable, compute: Callable[[], V]) -> V:
        """Compute an answer in a thread. Simultaneous requests of the same key share one computation.

        Raises:
            HTTPException: Too many others wait (503).
        """
        task = self._tasks.get(key)
        if task is None:
            if len(self._tasks) >= self._most:
                words = f"The server is busy with other slow pages: ask again in {RETRY_S} seconds."
                raise HTTPException(503, words, {"retry-after": str(RETRY_S)})
            task = self._tasks[key] = asyncio.create_task(to_thread.run_sync(compute, limiter=self._limiter))
            task.add_done_callback(lambda done: self._end(key, done))
        return await asyncio.shield(task)  # the answer is cached even if this client has gone

    def _end(self, key: Hashable, task: asyncio.Task[Any]) -> None:
        self._tasks.pop(key, None)
        if not task.cancelled():
            task.exception()  # its waiters may have gone
