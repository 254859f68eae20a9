"""What the dashboard shows of schedules."""

from contextlib import closing

import pytest

from robogauntlet.orchestrator.schedules.schedule import Schedule
from robogauntlet.orchestrator.schedules.store import UNSERVED_S, ScheduleStore
from robogauntlet.results.store.database import file_url
from tests.results.store.test_postgresql import server  # noqa: F401

NIGHTLY = Schedule(name="nightly", suite="smoke", cron="@daily")


def check(url):
    with closing(ScheduleStore.open(url)) as store, closing(ScheduleStore.open(url)) as other:
        store.write(NIGHTLY, next_due_at=1000.0, seen_at=900.0)
        other.write(NIGHTLY, outcome="fine", run_id="run-1")
        store.write(NIGHTLY.model_copy(update={"name": "another"}), seen_at=None)
        another, nightly = other.schedules()
        assert (nightly.next_due_at, nightly.outcome, nightly.run_id) == (1000.0, "fine", "run-1")
        assert nightly.is_served(900.0 + UNSERVED_S)
        assert not nightly.is_served(901.0 + UNSERVED_S)
        assert another.is_served(1e12)
        store.keep_only(["nightly"])
        assert other.schedules() == [nightly]


def test_a_schedule_has_what_was_last_written_of_each_value(tmp_path):
    check(file_url(tmp_path / "history.sqlite"))


@pytest.mark.slow
def test_postgresql_stores_schedules_too(server):  # noqa: F811
    check(server)
