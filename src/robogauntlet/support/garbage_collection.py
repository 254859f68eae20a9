"""Python's garbage collector while a process starts."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collector_paused() -> Iterator[None]:
    """Pause the garbage collector, and let it ignore what is there at the end.

    Imports of a simulator and of a network make almost a million objects that stay as long as the process: to look for
    garbage among them again and again takes a sixth of the imports' time. For processes that only this package uses.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
