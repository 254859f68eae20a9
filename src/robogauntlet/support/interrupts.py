"""Blocks that an interruption must not divide."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals that ask a process to end."""


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Deliver a Ctrl-C or SIGTERM that arrives during the block after it.

    Keep the block short. Other threads than the main one never receive signals, so they run the block as it is.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before = {}

    def note(number: int, frame: FrameType | None) -> None:
        arrived.append(number)

    try:
        for number in SIGNALS:
            if (handler := signal.getsignal(number)) is not None:  # one that Python did not set cannot be set again
                before[number] = handler
                signal.signal(number, note)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in dict.fromkeys(arrived):
            signal.raise_signal(number)
