"""The store of schedules: each due time is recorded exactly once."""

import sqlite3
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robogauntlet.orchestrator.schedules.schedule import CatchUp, Schedule, ScheduleError, State
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.store.database import StoreError, file_url

START = 1_795_000_000.0


def schedule(name="nightly", **changes):
    values = {"suite": "smoke", "cron": "*/10 * * * *", "created_at": START, **changes}
    return Schedule(name, **values)


@pytest.fixture
def schedule_store(tmp_path):
    opened = ScheduleStore.open(file_url(tmp_path / "history.sqlite"))
    yield opened
    opened.close()


def folder(schedule, due_at):
    return f"/runs/{schedule.name}-{due_at:.0f}"


def test_a_schedule_is_read_as_it_was_written(schedule_store):
    made = schedule(timezone="Europe/Berlin", arguments=("--seeds=3",), catch_up=CatchUp.ALL, keep=7, gate=False)
    schedule_store.add(made)
    assert schedule_store.schedules() == [made]
    assert schedule_store.find("nightly") == made
    with pytest.raises(ScheduleError, match="schedule 'nightly' exists"):
        schedule_store.add(made)


def test_removing_a_schedule_keeps_its_started_runs(schedule_store):
    schedule_store.add(schedule())
    schedule_store.record_due(START + 1800, folder)
    schedule_store.change(schedule_store.scheduled_runs()[0], state=State.DONE, outcome="fine")
    assert schedule_store.remove("nightly")
    assert not schedule_store.remove("nightly")
    assert [one.outcome for one in schedule_store.scheduled_runs()] == ["fine"]


@settings(max_examples=30)
@given(steps=st.lists(st.floats(0.0, 7200.0), min_size=1, max_size=8))
def test_each_due_time_is_recorded_once_however_often_it_is_called(tmp_path_factory, steps):
    schedule_store = ScheduleStore.open(file_url(tmp_path_factory.mktemp("schedule_store") / "history.sqlite"))
    made, now = schedule(), START
    schedule_store.add(made)
    for step in steps:
        now += step
        schedule_store.record_due(now, folder)
        schedule_store.record_due(now - 100, folder)  # a clock that was set back
    assert sorted(one.due_at for one in schedule_store.scheduled_runs()) == list(made.due(START, now))
    schedule_store.close()


def test_simultaneous_processes_record_each_due_time_once(schedule_store, tmp_path):
    schedule_store.add(schedule())
    stores = [ScheduleStore.open(file_url(tmp_path / "history.sqlite")) for _ in range(4)]

    def record(store):
        return sum(store.record_due(START + 60 * minute, folder) for minute in range(0, 100, 7))

    with ThreadPoolExecutor(4) as pool:
        recorded = sum(pool.map(record, stores))
    expected = list(schedule().due(START, START + 60 * 98))
    assert sorted(one.due_at for one in schedule_store.scheduled_runs()) == expected
    assert recorded == len(expected)
    for store in stores:
        store.close()


def test_missed_times_are_recorded_for_the_last_month_only(schedule_store):
    schedule_store.add(schedule(cron="0 * * * *"))
    schedule_store.record_due(START + 3 * 365 * 86_400, folder)
    assert len(schedule_store.scheduled_runs()) == 31 * 24


def test_a_store_of_a_newer_version_is_refused(tmp_path):
    path = tmp_path / "history.sqlite"
    ScheduleStore.open(file_url(path)).close()
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE robogauntlet_schedules SET version = 9")
    connection.close()
    with pytest.raises(StoreError, match="expected a schedule store of version 1, got version 9"):
        ScheduleStore.open(file_url(path))
