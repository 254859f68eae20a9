"""Sends a message to everybody who is to be told."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Sequence

from orchestrator.telling.message import Message
from orchestrator.telling.teller import NotTold, Teller

TOTAL_S = 60.0
"""After which what is not sent is given up, whatever it is doing."""


def tell(message: Message, tellers: Sequence[Teller], *, total_s: float = TOTAL_S) -> list[str]:
    """Send a message to all at once, each with its own retries, and wait until all are done or the time is over.

    Args:
        message: What to tell.
        tellers: Whom; see `tellers`.
        total_s: How long to wait for all of them together (s).

    Returns:
        A line for each that was not told: which, what came, what to do. No line has a secret. Empty if all were told.
    """
    answers: queue.SimpleQueue[tuple[int, str | None]] = queue.SimpleQueue()

    def send(place: int, teller: Teller) -> None:
        answers.put((place, _trouble(message, teller)))

    for place, teller in enumerate(tellers):
        # A daemon: a server that drips its answer byte by byte must not keep the program from ending.
        threading.Thread(target=send, args=(place, teller), name=f"tell {place}", daemon=True).start()
    troubles: list[str | None] = [f"not sent within {total_s:g} s; see whether it is reached from here"] * len(tellers)
    end = time.monotonic() + total_s
    for _ in tellers:
        try:
            place, trouble = answers.get(timeout=max(0.0, end - time.monotonic()))
        except queue.Empty:
            break
        troubles[place] = trouble
    found = zip(tellers, troubles, strict=True)
    return [f"could not tell of {message.run}: {teller.name}: {words}" for teller, words in found if words is not None]


def _trouble(message: Message, teller: Teller) -> str | None:
    """Why a teller did not send, or None if it did."""
    try:
        teller.send(message)
    except NotTold as error:
        return str(error)
    except Exception as error:  # its text may hold anything, and a thread would print it
        return f"unexpected {type(error).__name__}; please report it"
    return None
