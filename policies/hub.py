"""Downloads from the Hugging Face hub, which can be refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from robogauntlet.policies.contract import PolicyError

_ALLOWED = ContextVar("downloads are allowed", default=True)


class OnHub(PolicyError):
    """A reference to the hub, where nothing may be downloaded."""


@contextmanager
def without_downloads() -> Iterator[None]:
    """Let `check_download` raise during the block."""
    token = _ALLOWED.set(False)
    try:
        yield
    finally:
        _ALLOWED.reset(token)


def check_download(reference: str) -> None:
    """Call this before something is downloaded. Raises OnHub within `without_downloads`."""
    if not _ALLOWED.get():
        raise OnHub(f"'{reference}' would be downloaded from the hub")
