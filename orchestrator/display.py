"""What long work shows of itself: a live picture on a terminal, plain lines now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Self

from rich.console import Console, RenderableType
from rich.live import Live

PLAIN_EVERY_S = 10.0
"""Between two showings where there is no terminal."""


class Display:
    """Base of everything that shows progress; a context, within which `draw` shows."""

    def __init__(self, console: Console, *, transient: bool = False, now: Callable[[], float] = time.monotonic) -> None:
        """Args: console: where to; transient: leave nothing of the live picture behind; now: seconds, from anywhere."""
        self._console, self._transient, self._now = console, transient, now
        self._live: Live | None = None
        self._said_at = now()

    def __enter__(self) -> Self:
        self._said_at = self._now()
        if self._console.is_terminal:
            self._live = Live(console=self._console, refresh_per_second=4, transient=self._transient)
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        live, self._live = self._live, None
        if live is not None:
            live.__exit__(kind, error, trace)

    def say(self, message: str) -> None:
        """A line for the user."""
        self._console.print(message, highlight=False, markup=False, soft_wrap=True)

    def draw(
        self, picture: Callable[[], RenderableType], lines: Callable[[], Iterable[str]], *, at_once: bool = False
    ) -> None:
        """Show how things stand.

        Args:
            picture: For a terminal.
            lines: For anything else; not asked for more often than every `PLAIN_EVERY_S`.
            at_once: Do not wait with the lines.
        """
        if self._live is not None:
            self._live.update(picture())
        elif at_once or self._now() - self._said_at >= PLAIN_EVERY_S:
            self._said_at = self._now()
            for line in lines():
                self.say(line)
