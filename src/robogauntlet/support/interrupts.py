"""Interruptions by Ctrl-C or SIGTERM: none is lost, and none divides a block that must be whole."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals that ask a process to end."""
AGAIN_S = 0.05
"""Time after which a lost interruption comes again (s)."""
EXIT_INTERRUPTED = 130
"""Exit code of a command that was interrupted."""


@contextmanager
def raised_interrupts() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM raise KeyboardInterrupt during the block, wherever they arrive.

    Python drops an exception that is raised where none can be handed on: in a destructor, or in a callback of an
    import. Such an interruption comes again. The handler of SIGTERM stays after the block.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _raise)
    before = sys.unraisablehook

    def repeat(dropped: Any) -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            # In a thread: a signal that arrived here would be dropped, too.
            threading.Thread(target=_interrupt_again, daemon=True).start()
        else:
            before(dropped)

    sys.unraisablehook = repeat
    try:
        yield
    finally:
        sys.unraisablehook = before


def _interrupt_again() -> None:
    time.sleep(AGAIN_S)
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    os.kill(os.getpid(), signal.SIGTERM if ignored else signal.SIGINT)


def _raise(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


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
