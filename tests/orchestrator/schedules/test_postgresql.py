"""Schedules in a real PostgreSQL server."""

import pytest

from robogauntlet.orchestrator.schedules.schedule import CatchUp, Schedule, State
from robogauntlet.orchestrator.schedules.server import AlreadyRunning, exclusive_server, is_served
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from tests.orchestrator.schedules.test_store import START, folder
from tests.results.store.test_postgresql import server  # noqa: F401

pytestmark = pytest.mark.slow


def test_postgresql_stores_schedules_and_admits_one_server(server, tmp_path):  # noqa: F811
    schedule_store, other = ScheduleStore.open(server), ScheduleStore.open(server)
    made = Schedule("nightly", "smoke", "*/10 * * * *", "Europe/Berlin", ("--seeds=3",), CatchUp.ALL, 7, False, START)
    schedule_store.add(made)
    assert other.schedules() == [made]
    assert (schedule_store.record_due(START + 3600, folder), other.record_due(START + 3600, folder)) == (6, 0)
    scheduled_run = other.scheduled_runs()[0]
    other.change(scheduled_run, state=State.DONE, outcome="fine")
    assert schedule_store.scheduled_runs(state=State.DONE)[0].due_at == scheduled_run.due_at
    with exclusive_server(schedule_store.database, tmp_path):
        with (
            pytest.raises(AlreadyRunning, match="another schedule server runs"),
            exclusive_server(other.database, tmp_path),
        ):
            pass
        assert is_served(other.database, tmp_path)
        assert "secret" not in schedule_store.database.where
    for store in 20 * (other, schedule_store):
        with exclusive_server(store.database, tmp_path):
            pass
    assert not is_served(other.database, tmp_path)
    assert schedule_store.remove("nightly")
    schedule_store.close()
    other.close()
