"""Progress displays: live on a terminal, plain lines in other output."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, Self

from rich.console import Console, RenderableType
from rich.live import Live

PLAIN_EVERY_S = 10.0
"""Time between two updates without a terminal (s)."""


class Display:
    """Base class of progress displays. A context manager, in which `draw` updates the display."""

    def __init__(self, console: Console, *, transient: bool = False, now: Callable[[], float] = time.monotonic) -> None:
        self._console, self._transient, self._now = console, transient, now
        self._live: Live | None = None
        self._printed_at = now()

    def __enter__(self) -> Self:
        self._printed_at = self._now()
        if self._console.is_terminal:
            self._live = Live(console=self._console, refresh_per_second=4, transient=self._transient)
            self._live.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        live, self._live = self._live, None
        if live is not None:
            live.stop()

    def log(self, message: str) -> None:
        """Print a line for the user."""
        self._console.print(message, highlight=False, markup=False, soft_wrap=True)

    def draw(
        self, picture: Callable[[], RenderableType], lines: Callable[[], Iterable[str]], *, at_once: bool = False
    ) -> None:
        """Update the display.

        Args:
            picture: Returns what a terminal shows.
            lines: Returns the lines for other output; called at most every `PLAIN_EVERY_S`.
            at_once: Print the lines immediately.
        """
        if self._live is not None:
            self._live.update(picture())
        elif at_once or self._now() - self._printed_at >= PLAIN_EVERY_S:
            self._printed_at = self._now()
            for line in lines():
                self.log(line)
