"""What all pages share: the open history and calendar, the templates, what is kept of slow answers."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import Depends, Request
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.responses import HTMLResponse, Response

from orchestrator.calendar.book import Book
from orchestrator.dashboard import assets, queries, views
from orchestrator.dashboard.guard import Sessions
from orchestrator.dashboard.memory import Memory
from results.comparison import Comparison
from results.database import StoreError
from results.history import History
from results.leaderboard import Standing
from results.report import text
from results.report.nights import verdict_text, when
from results.statistics.rates import wilson_interval
from results.syncing import take_in

SYNC_S = 30.0
"""Time between two looks for runs in folders that the history does not know (s)."""
LIVE_S = 0.5
"""How long what runs is kept: however many watch, the database is asked that often (s)."""
NAMES_S = 15.0
"""How long lists of names are kept (s)."""
log = logging.getLogger("gauntlet.dashboard")


@dataclass(frozen=True)
class Settings:
    """How a dashboard is served."""

    root: Path
    """Folder of runs: looked through for new ones; uploads go there."""
    host: str = "127.0.0.1"
    token: str | None = field(default=None, repr=False)
    """Demanded of every request; None: of none, which is for loopback only."""
    max_upload: int = 256 * 1024 * 1024
    """Bytes of an uploaded run."""


@dataclass(frozen=True)
class Names:
    """What can be chosen in filters."""

    suites: tuple[str, ...]
    statuses: tuple[str, ...]
    policies: tuple[str, ...]


class Desk:
    """An open dashboard."""

    def __init__(self, history: History, book: Book, settings: Settings) -> None:
        """Serve from a history and the calendar in the same database."""
        self.history, self.book, self.settings = history, book, settings
        self.sessions = Sessions()
        self.comparisons: Memory[tuple[Any, ...], Comparison] = Memory(64)
        self.standings: Memory[tuple[Any, ...], tuple[list[Standing], list[str]]] = Memory(32)
        self.films: Memory[tuple[Any, ...], tuple[Any, ...]] = Memory(512)
        self.lives: Memory[str, bytes] = Memory(64, LIVE_S)
        self.names: Memory[str, Names] = Memory(1, NAMES_S)
        self.taking_in = threading.Lock()
        """Held while runs are put under the root or recorded from there."""
        self._ended = threading.Event()
        self._templates = Environment(
            loader=FileSystemLoader(assets.HERE / "templates"),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self._templates.globals.update(
            text=text, views=views, when=when, verdict_text=verdict_text, query=query, asset=assets.address
        )

    def page(self, template: str, *, status: int = 200, **values: Any) -> Response:
        """A page of this template."""
        values = {"here": "", "now": time.time(), "has_token": self.settings.token is not None, **values}
        return HTMLResponse(self._templates.get_template(template).render(values), status)

    def trouble(self, message: str, status: int) -> Response:
        """A page that says in a line what is wrong."""
        return self.page("trouble.html.jinja", status=status, title=TITLES.get(status, "Trouble"), message=message)

    def choices(self) -> Names:
        """Names for filters, at most `NAMES_S` old. Raises StoreError."""
        return self.names.get(
            "all",
            lambda: Names(
                tuple(self.history.suites()),
                tuple(queries.statuses(self.history)),
                tuple(self.history.policies()),
            ),
        )

    def begin(self) -> None:
        """Look for runs in folders now and then, until `end`."""
        self._ended.clear()
        threading.Thread(target=self._keep_looking, name="runs in folders", daemon=True).start()

    def end(self) -> None:
        """Stop looking."""
        self._ended.set()

    def _keep_looking(self) -> None:
        wilson_interval(1, 2)  # loads what computes it, which takes seconds, before a page waits for it
        while True:
            try:
                with self.taking_in:
                    if self.settings.root.is_dir():
                        take_in(self.history, self.settings.root)
            except (StoreError, OSError) as error:
                log.warning("runs under %s were not looked through: %s", self.settings.root, error)
            if self._ended.wait(SYNC_S):
                return


TITLES = {400: "Not understood", 404: "Not there", 413: "Too large", 500: "Something went wrong", 503: "No answer"}


def query(**values: object) -> str:
    """The query part of an address, without what is None or empty."""
    found = urlencode({name: value for name, value in values.items() if value not in (None, "")})
    return f"?{found}" if found else ""


async def desk_of(request: Request) -> Desk:
    """The dashboard that a request is for."""
    desk: Desk = request.app.state.desk
    return desk


TheDesk = Annotated[Desk, Depends(desk_of)]
