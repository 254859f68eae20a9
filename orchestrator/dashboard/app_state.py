"""State that all pages share: the open stores, the templates and the cache."""

from __future__ import annotations

import hashlib
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar
from urllib.parse import urlencode

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, HTTPException, Request
from starlette.responses import HTMLResponse, Response

from robogauntlet.orchestrator.dashboard import live_view, queries
from robogauntlet.orchestrator.dashboard.answers import Answers
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.report import formatting, page
from robogauntlet.results.report.history_tables import verdict_text, when
from robogauntlet.results.report.templates import template_environment
from robogauntlet.results.store.history_import import record_run_folders
from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.results.store.run_history import History

SYNC_S = 30.0
"""Interval at which run folders that the history does not list are imported (s)."""
NAMES_S = 15.0
"""Lifetime of the cached lists of names (s)."""
CACHED = 4096
"""Answers that are kept: comparisons, leaderboards, videos and kinds of failures of a run."""
SLOW_PAGES = 2
"""Slow pages that are computed at a time, since they need memory; others wait without holding up the rest."""
P = ParamSpec("P")
V = TypeVar("V")
log = logging.getLogger("robogauntlet.dashboard")
FOLDER = Path(__file__).parent
FILES = {
    "report.css": page.FOLDER / "report.css",
    "dashboard.css": FOLDER / "static" / "dashboard.css",
    "live.js": FOLDER / "static" / "live.js",
}
"""Style sheets and the script; they need no token, since they are the same in every installation."""
TITLES = {400: "Bad request", 404: "Not found", 500: "Internal error", 503: "Unavailable"}


@dataclass(frozen=True)
class Settings:
    """Settings of the dashboard."""

    root: Path
    """Folder of the run folders, which is scanned for new runs."""
    host: str = "127.0.0.1"
    token: str | None = field(default=None, repr=False)
    """Token that every request must carry; None, for loopback addresses only, if none is needed."""
    public_host: str | None = None
    """Name by which browsers call the dashboard, if a proxy is in front of it."""
    is_https: bool = False
    """Whether the proxy speaks TLS, so that cookies are sent over TLS only."""


@dataclass(frozen=True)
class Names:
    """Names that filters offer."""

    suites: list[str]
    statuses: list[str]
    policies: list[str]


class AppState:
    """State of a running dashboard."""

    def __init__(self, history: History, schedule_store: ScheduleStore, settings: Settings) -> None:
        """Serve a history and the schedules in the same database."""
        self.history, self.schedule_store, self.settings = history, schedule_store, settings
        self.answers, self._slow = Answers(CACHED), CapacityLimiter(SLOW_PAGES)
        self._stopped = threading.Event()
        self._named: set[str] = set()
        """Lines about runs that cannot be recorded, each logged once."""
        self._templates = template_environment(FOLDER / "templates", page.FOLDER)
        self._templates.globals.update(
            text=formatting, views=live_view, when=when, verdict_text=verdict_text, query=query, asset=asset_address
        )

    def page(self, template: str, *, status: int = 200, **values: Any) -> Response:
        """Render a page."""
        return HTMLResponse(
            self._templates.get_template(template).render({"here": "", "now": time.time()} | values), status
        )

    def error_page(self, message: str, status: int) -> Response:
        """Render a page with an error message."""
        return self.page("error.html.jinja", status=status, title=TITLES.get(status, "Error"), message=message)

    async def slowly(self, answer: Callable[P, V], *arguments: P.args, **named: P.kwargs) -> V:
        """Compute a slow page in one of the threads that are kept for these."""
        return await to_thread.run_sync(lambda: answer(*arguments, **named), limiter=self._slow)

    def run_named(self, name: str) -> RunEntry:
        """Return the run of that id or name. Raises HTTPException if there is none, StoreError."""
        entry = queries.run_of(self.history, name) or self.history.find(name)
        if entry is None:
            raise HTTPException(404, f"The history has no run '{name[:80]}'.")
        return entry

    def choices(self) -> Names:
        """Return the names for filters, at most `NAMES_S` old. Raises StoreError."""
        return self.answers.get("names", self._read_names, NAMES_S)

    def _read_names(self) -> Names:
        return Names(list(self.history.suites()), list(queries.statuses(self.history)), self.history.policies())

    def begin(self) -> None:
        """Import new run folders every `SYNC_S`, until `end`."""
        self._stopped.clear()
        threading.Thread(target=self._import_runs, name="import of runs", daemon=True).start()

    def end(self) -> None:
        """Stop importing."""
        self._stopped.set()

    def _name_once(self, line: str) -> None:
        if line not in self._named:
            self._named.add(line)
            log.warning("%s", line)

    def _import_runs(self) -> None:
        while True:
            try:
                if self.settings.root.is_dir():
                    record_run_folders(self.history, self.settings.root, self._name_once)
            except Exception as error:  # one broken run must not end the import of the others
                log.warning("runs under %s were not imported: %s", self.settings.root, error)
            if self._stopped.wait(SYNC_S):
                return


def query(**values: object) -> str:
    """Return the query part of an address, without values that are None or empty."""
    encoded = urlencode({name: value for name, value in values.items() if value not in (None, "")})
    return f"?{encoded}" if encoded else ""


@cache
def asset_address(name: str) -> str:
    """Return the address of a file, which depends on its content so that browsers can cache it."""
    return f"/static/{name}?v={hashlib.sha256(FILES[name].read_bytes()).hexdigest()[:12]}"


async def app_state_of(request: Request) -> AppState:
    """Return the state of the dashboard that serves a request."""
    app_state: AppState = request.app.state.app_state
    return app_state


CurrentAppState = Annotated[AppState, Depends(app_state_of)]
