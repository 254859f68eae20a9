"""Answers that take long to make, kept for a while."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Memory(Generic[K, V]):
    """The answers used last, by question. What is asked for twice at once is made once. Any number of threads."""

    def __init__(self, size: int, seconds: float = float("inf")) -> None:
        """Keep `size` answers, each for so long."""
        self._size, self._seconds = size, seconds
        self._kept: OrderedDict[K, tuple[float, V]] = OrderedDict()
        self._lock, self._making = threading.Lock(), threading.Lock()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The answer to a question; made if it is not there. What `make` raises is raised and not kept."""
        found = self._look(key)
        if found is None:
            with self._making:  # one at a time: what is made here takes memory
                found = self._look(key)
                if found is None:
                    found = (time.monotonic(), make())
                    self._keep(key, found)
        return found[1]

    def _look(self, key: K) -> tuple[float, V] | None:
        with self._lock:
            found = self._kept.get(key)
            if found is None or time.monotonic() - found[0] > self._seconds:
                return None
            self._kept.move_to_end(key)
            return found

    def _keep(self, key: K, found: tuple[float, V]) -> None:
        with self._lock:
            self._kept[key] = found
            self._kept.move_to_end(key)
            while len(self._kept) > self._size:
                self._kept.popitem(last=False)
