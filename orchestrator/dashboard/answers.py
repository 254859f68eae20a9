"""A cache of answers that take long."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from typing import Any, TypeVar

from cachetools import TLRUCache

V = TypeVar("V")


class Answers:
    """A thread-safe cache of the most recently used answers; simultaneous requests compute an answer once."""

    def __init__(self, size: int) -> None:
        """Keep up to `size` answers."""
        self._known: TLRUCache[Hashable, tuple[Future[Any], float]] = TLRUCache(size, lambda _, one, now: now + one[1])
        self._lock = threading.Lock()

    def get(self, key: Hashable, compute: Callable[[], V], seconds: float = float("inf")) -> V:
        """Return the answer for a key; compute it if it is not cached, and keep it for `seconds`.

        Exceptions are raised and not cached.
        """
        with self._lock:
            known = self._known.get(key)
            answer: Future[V] = Future() if known is None else known[0]
            if known is None:
                self._known[key] = answer, seconds
        if known is None:
            try:
                answer.set_result(compute())
            except BaseException as error:
                with self._lock:
                    self._known.pop(key, None)
                answer.set_exception(error)
        return answer.result()
