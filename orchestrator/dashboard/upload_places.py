"""Places for uploads: how many arrive at a time, and how much room all uploaded runs may take."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from fastapi import HTTPException
from starlette.concurrency import run_in_threadpool

AT_ONCE = 8
"""Uploads that arrive at a time."""
WAIT_S = 10.0
"""How long an upload waits for a place (s)."""
MEASURE_S = 600.0
"""Interval at which the room is measured (s); in between, what arrives is added."""
REMEASURE_S = 10.0
"""The same when there seems to be no room (s), since runs may have been removed."""


@dataclass
class Place:
    """The place of an upload."""

    size: int
    """Its size (bytes): at first the largest possible."""


class UploadPlaces:
    """Gives a place to each upload, or refuses it. For one event loop."""

    def __init__(self, quota: int, measure: Callable[[], int], at_once: int = AT_ONCE, wait_s: float = WAIT_S) -> None:
        """Let uploaded runs take `quota` bytes in all; `measure` returns what they take."""
        self._quota, self._measure, self._wait_s = quota, measure, wait_s
        self._places, self._measuring = asyncio.Semaphore(at_once), asyncio.Lock()
        self._used, self._arriving, self._measured_at = 0, 0, float("-inf")

    @asynccontextmanager
    async def place(self, size: int) -> AsyncIterator[Place]:
        """Hold a place for an upload of at most `size` bytes, whose size is counted as used if nothing is raised.

        Raises:
            HTTPException: There is no room (507), or no place for longer than the wait (503).
        """
        try:
            async with asyncio.timeout(self._wait_s):
                await self._places.acquire()
        except TimeoutError:
            raise HTTPException(503, "other uploads are arriving: try again", {"retry-after": "10"}) from None
        try:
            await self._reserve(size)
            try:
                place = Place(size)
                yield place
                self._used += place.size
            finally:
                self._arriving -= size
        finally:
            self._places.release()

    async def _reserve(self, size: int) -> None:
        async with self._measuring:
            age = time.monotonic() - self._measured_at
            if age > MEASURE_S or (age > REMEASURE_S and self._is_full(size)):
                self._used = await run_in_threadpool(self._measure)
                self._measured_at = time.monotonic()
            if self._is_full(size):
                raise HTTPException(
                    507,
                    f"uploaded runs may take {self._quota / 1e9:,.3g} GB in all (robogauntlet serve --max-uploads-gb); "
                    "remove some: robogauntlet forget RUN --delete",
                )
            self._arriving += size

    def _is_full(self, size: int) -> bool:
        return self._used + self._arriving + size > self._quota


def size_of(folder: Path) -> int:
    """Return the size of all files under a folder (bytes), 0 if it is gone."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.lstat().st_size
        except OSError:  # it has just been removed
            continue
    return total
