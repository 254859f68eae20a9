"""State that all pages share: the open stores, the templates and the caches."""

from __future__ import annotations

import hashlib
import logging
import threading
import time
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlencode

from anyio import CapacityLimiter
from fastapi import Depends, HTTPException, Request
from starlette.responses import HTMLResponse, Response

from robogauntlet.orchestrator.dashboard import live_view, queries
from robogauntlet.orchestrator.dashboard.access import Access
from robogauntlet.orchestrator.dashboard.answers import WAITING, AnswerCache, SlowWork
from robogauntlet.orchestrator.dashboard.bodies import GRACE_S
from robogauntlet.orchestrator.dashboard.origins import Origin
from robogauntlet.orchestrator.dashboard.upload_places import UploadPlaces, size_of
from robogauntlet.orchestrator.schedules.server import why_unserved
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.analysis.comparison import Comparison
from robogauntlet.results.analysis.leaderboard import LeaderboardRow
from robogauntlet.results.analysis.pairwise import PairwiseComparisons
from robogauntlet.results.record import FailureKind
from robogauntlet.results.report import formatting, page
from robogauntlet.results.report.history_plot import verdict_text, when
from robogauntlet.results.report.templates import template_environment
from robogauntlet.results.store.arriving import remove_abandoned
from robogauntlet.results.store.history_import import record_run_folders
from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.results.store.run_history import History

SYNC_S = 30.0
"""Interval at which run folders that the history does not list are imported (s)."""
LIVE_S = 0.5
"""Lifetime of the cached live status (s); it limits the load of the database, however many browsers watch."""
NAMES_S = 15.0
"""Lifetime of the cached lists of names (s)."""
UNSERVED_S = 5.0
"""Lifetime of the cached answer whether the schedules are served (s)."""
LONGEST_TEXT = 10_000
"""Largest length of a name or a message on a page (characters); longer ones are cut."""
log = logging.getLogger("robogauntlet.dashboard")
FOLDER = Path(__file__).parent
FILES = {
    "report.css": page.FOLDER / "report.css",
    "dashboard.css": FOLDER / "static" / "dashboard.css",
    "live.js": FOLDER / "static" / "live.js",
}
"""Style sheets and the script; they need no token, since they are the same in every installation."""


@dataclass(frozen=True)
class Settings:
    """Settings of the dashboard."""

    root: Path
    """Folder of the run folders, which is scanned for new runs and receives uploads."""
    host: str = "127.0.0.1"
    token: str | None = field(default=None, repr=False)
    """Token that every request must carry; None, for loopback addresses only, if none is needed."""
    read_token: str | None = field(default=None, repr=False)
    """A second token, for requests that only read."""
    public: Origin | None = None
    """Origin of the pages in browsers, if a proxy is in front of the dashboard."""
    max_upload: int = 256 * 1024 * 1024
    """Largest size of an uploaded run (bytes)."""
    max_uploads: int = 20_000_000_000
    """Largest size of all uploaded runs together (bytes)."""
    body_grace_s: float = GRACE_S
    """Time that every body of a request may take (s)."""


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
        self.access = Access(settings.token, settings.read_token)
        self.comparisons: AnswerCache[tuple[Any, ...], Comparison] = AnswerCache(64)
        self.pairwise: AnswerCache[tuple[Any, ...], PairwiseComparisons] = AnswerCache(64)
        self.standings: AnswerCache[str, tuple[Hashable, tuple[list[LeaderboardRow], list[str]]]] = AnswerCache(32)
        self.failure_videos: AnswerCache[tuple[Any, ...], tuple[Any, ...]] = AnswerCache(512)
        self.failure_kinds: AnswerCache[tuple[Any, ...], Mapping[FailureKind, int]] = AnswerCache(2048)
        self.live_status: AnswerCache[str, bytes] = AnswerCache(64, LIVE_S)
        self.names: AnswerCache[str, Names] = AnswerCache(1, NAMES_S)
        self._unserved: AnswerCache[str, str] = AnswerCache(1, UNSERVED_S)
        self.slow, self.leaderboards, self.browsing = SlowWork(1, WAITING), SlowWork(1, WAITING), SlowWork(4, 20)
        """Comparisons; leaderboards; and pages that read the rows of many runs."""
        self.uploads = UploadPlaces(settings.max_uploads, self._size_of_uploads)
        self.imports, self.reports, self.checks = CapacityLimiter(1), CapacityLimiter(1), CapacityLimiter(2)
        """Threads that import uploaded runs, that write their reports, and that check health."""
        self.import_lock = threading.Lock()
        """Held while runs are written under the root or imported from it."""
        self._stopped = threading.Event()
        self._named: set[str] = set()
        """Lines about runs that cannot be recorded, each logged once."""
        self._templates = template_environment(FOLDER / "templates", page.FOLDER, longest=LONGEST_TEXT)
        self._templates.globals.update(
            text=formatting, views=live_view, when=when, verdict_text=verdict_text, query=query, asset=asset_address
        )

    def page(self, template: str, *, status: int = 200, **values: Any) -> Response:
        """Render a page."""
        values = {"here": "", "now": time.time(), "has_token": bool(self.access.tokens), **values}
        return HTMLResponse(self._templates.get_template(template).render(values), status)

    def error_page(self, message: str, status: int) -> Response:
        """Render a page with an error message."""
        return self.page("error.html.jinja", status=status, title=TITLES.get(status, "Error"), message=message)

    def run_named(self, name: str) -> RunEntry:
        """Return the run of that id or name. Raises HTTPException if there is none, StoreError."""
        entry = queries.run_of(self.history, name) or self.history.find(name)
        if entry is None:
            raise HTTPException(404, f"The history has no run '{name[:80]}'.")
        return entry

    def choices(self) -> Names:
        """Return the names for filters, at most `NAMES_S` old. Raises StoreError."""
        return self.names.get("all", self._read_names)

    def unserved(self) -> str:
        """A line if no process serves the schedules, or nothing. Raises StoreError."""
        places = self.schedule_store, self.settings.root
        return self._unserved.get("", lambda: why_unserved(*places, time.time()) or "")

    def _read_names(self) -> Names:
        lists = (self.history.suites(), queries.statuses(self.history), self.history.policies())
        return Names(*(list(islice(names, queries.MOST_NAMES)) for names in lists))

    def _size_of_uploads(self) -> int:
        return sum(size_of(Path(folder)) for folder in queries.imported_folders(self.history))

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
                with self.import_lock:
                    if self.settings.root.is_dir():
                        remove_abandoned(self.settings.root)
                        record_run_folders(self.history, self.settings.root, self._name_once)
            except Exception as error:  # one broken run must not end the import of the others
                log.warning("runs under %s were not imported: %s", self.settings.root, error)
            if self._stopped.wait(SYNC_S):
                return


TITLES = {400: "Bad request", 404: "Not found", 413: "Too large", 500: "Internal error", 503: "Unavailable"}


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
