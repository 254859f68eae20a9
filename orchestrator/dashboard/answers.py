"""Caches of what takes long to compute, and the turns in which it is computed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

from cachetools import TTLCache

WAITING = 5
"""Requests that may wait for their turn; each holds a thread of those that all pages share."""
RETRY_S = 5
"""Time after which a refused client may ask again (s)."""
K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Busy(Exception):
    """Too many requests wait for their turn already."""


class Turns:
    """Lets threads compute one at a time."""

    def __init__(self, waiting: int | None = WAITING) -> None:
        """Let at most `waiting` threads wait; None for any number."""
        self._limit, self._waiting = waiting, 0
        self._lock, self._computing = threading.Lock(), threading.Lock()

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Wait for the turn, and hold it. Raises Busy if too many wait already."""
        with self._lock:
            if self._limit is not None and self._waiting >= self._limit:
                raise Busy(f"expected at most {self._limit} waiting requests; ask again in {RETRY_S} seconds")
            self._waiting += 1
        try:
            self._computing.acquire()
        finally:
            with self._lock:
                self._waiting -= 1
        try:
            yield
        finally:
            self._computing.release()


class AnswerCache(Generic[K, V]):
    """A thread-safe cache of the most recently used answers; simultaneous requests compute an answer once."""

    def __init__(self, size: int, seconds: float = float("inf"), turns: Turns | None = None) -> None:
        """Keep up to `size` answers, each for `seconds`; compute them in `turns`, by default in turns of its own."""
        self._answers: TTLCache[K, V] = TTLCache(size, seconds)
        self._lock, self._turns = threading.Lock(), turns or Turns(None)

    def get(self, key: K, compute: Callable[[], V]) -> V:
        """Return the answer for a key; compute it if it is not cached. Exceptions are raised and not cached.

        Raises:
            Busy: The answer is not cached, and too many others are being computed.
        """
        if (answer := self._cached(key)) is not None:
            return answer
        with self._turns.turn():  # one at a time, since answers need memory
            if (answer := self._cached(key)) is not None:
                return answer
            answer = compute()
            with self._lock:
                self._answers[key] = answer
            return answer

    def _cached(self, key: K) -> V | None:
        with self._lock:
            return self._answers.get(key)
