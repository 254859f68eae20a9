"""Keeps urllib3 from writing addresses into logs while this program sends to a secret one.

It logs the path of what it asks for, in a warning each time that it tries again.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from contextvars import ContextVar

_quiet: ContextVar[bool] = ContextVar("quiet", default=False)


class _Drop(logging.Filter):
    def filter(self, record: logging.LogRecord) -> bool:
        return not _quiet.get()


_DROP = _Drop()


@contextlib.contextmanager
def quiet(package: str = "urllib3") -> Iterator[None]:
    """In here, the loggers of a package say nothing in this thread; in other threads they go on."""
    names = [name for name in logging.root.manager.loggerDict if name == package or name.startswith(f"{package}.")]
    for name in names:
        logging.getLogger(name).addFilter(_DROP)  # once, however often it is added
    token = _quiet.set(True)
    try:
        yield
    finally:
        _quiet.reset(token)
