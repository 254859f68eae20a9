"""The dashboard of a history that is on a PostgreSQL server."""

import time

import pytest

from robogauntlet.orchestrator.schedules.schedule import Schedule
from tests.orchestrator.dashboard.conftest import fill, serving
from tests.orchestrator.dashboard.filled import live_status, running
from tests.results.store.test_postgresql import server  # noqa: F401

pytestmark = pytest.mark.slow


def test_every_page_works_with_postgresql(tmp_path, server):  # noqa: F811
    made = fill(tmp_path, url=server)
    last, before = made[-1][1].run_id, made[-2][1].run_id
    with serving(tmp_path, url=server) as served:
        running(served.history, live_status(120))
        night = Schedule(name="night", suite="mergevla", cron="0 2 * * *")
        served.schedule_store.write(night, next_due_at=time.time() + 60.0, seen_at=time.time())
        expected = {
            "/": "▼ regressed",
            "/runs?suite=nightly&status=complete&policy=merged": "1 to 4 of 4 runs",
            f"/runs/{last}": "robosuite/<wbr>Door",
            f"/compare?first={last}&second={before}": "REGRESSED",
            "/history?policy=merged&suite=nightly&task=robosuite/Door": f'href="/runs/{last}"',
            "/leaderboard?suite=nightly": "<b>a</b>",
            "/failures": "<video",
            "/schedule": "0 2 * * *",
            "/api/live": '"running-1"',
            "/metrics": 'robogauntlet_last_verdict{suite="nightly",verdict="regressed"} 1.0',
            "/healthz": "ok",
        }
        found = {path: served.get(path).text for path in expected}
        assert [path for path, words in expected.items() if words not in found[path]] == []
        assert "secret" not in "".join(found.values())
