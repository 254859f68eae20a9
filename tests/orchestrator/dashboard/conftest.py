"""A dashboard that is served on a free port from a real store."""

import contextlib
import logging
import threading
import time

import httpx2
import pytest

from robogauntlet.orchestrator.cli.serve.dashboard import listen
from robogauntlet.orchestrator.dashboard.app import create_app, server_of
from robogauntlet.orchestrator.dashboard.app_state import Settings
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import History
from tests.orchestrator.dashboard.filled import DAY, add_videos, nightly_run, record_verdict

NOW = 1_790_000_000.0
PLAIN = {"timeout": 30, "trust_env": False, "verify": False}
"""Options of requests without certificates, which would be read for each: most of its processor time."""


class Served:
    """A served dashboard and what it is served from."""

    def __init__(self, root, history, schedule_store, address):
        self.root, self.history, self.schedule_store, self.address = root, history, schedule_store, address
        self.requested = []

    def get(self, path, **options):
        return httpx2.get(self.address + path, **(PLAIN | options))

    def post(self, path, **options):
        return httpx2.post(self.address + path, **(PLAIN | options))


@contextlib.contextmanager
def serving(root, before=None, url=None, **settings):
    """Serve the history under `root`, or that at a URL.

    `before(served, path)` is called in the server before each answer.
    """
    root.mkdir(parents=True, exist_ok=True)
    history = History.open(file_url(root / "history.sqlite")) if url is None else History.open(url)
    schedule_store = ScheduleStore.open(history.url)
    listening = listen("127.0.0.1", 0)
    served = Served(root, history, schedule_store, f"http://127.0.0.1:{listening.getsockname()[1]}")
    app = create_app(history, schedule_store, Settings(root, **settings))

    async def noting(scope, receive, send):
        if scope["type"] == "http":
            served.requested.append(scope["path"])
            if before is not None:
                before(served, scope["path"])
        await app(scope, receive, send)

    server = server_of(noting)
    logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
    thread = threading.Thread(target=server.run, args=([listening],), daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    try:
        yield served
    finally:
        server.should_exit = True
        thread.join(10)
        schedule_store.close()
        history.close()
        listening.close()


def fill(root, nights=4, url=None):
    """Nightly runs with videos; the last one is worse."""
    root.mkdir(parents=True, exist_ok=True)
    history = History.open(file_url(root / "history.sqlite")) if url is None else History.open(url)
    made = []
    for number in range(nights):
        last = number == nights - 1
        folder, run, results = nightly_run(
            root, number, NOW + number * DAY, version=2 if last else 1, rate=0.5 if last else 0.95
        )
        record_run_folder(history, folder, run)
        record_verdict(history, folder, run)
        made.append((folder, run, results))
    add_videos(*made[-1])
    history.close()
    return made


@pytest.fixture(scope="session")
def filled(tmp_path_factory):
    """A served dashboard with four nights; tests of this fixture change nothing."""
    root = tmp_path_factory.mktemp("runs")
    made = fill(root)
    with serving(root) as served:
        served.made = made
        yield served
