"""Python's garbage collector while a process starts."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collector_paused() -> Iterator[None]:
    """Pause the garbage collector, and let it ignore what is there at the end.

    Imports of a simulator and of a network make hundreds of thousands of objects that stay as long as the process, and
    among which the collector looks for garbage again and again. For processes that only this package uses.
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
