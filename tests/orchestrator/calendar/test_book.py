"""Promises of orchestrator/calendar/book.py: what is due is written down exactly once."""

import sqlite3
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.calendar.book import Book
from orchestrator.calendar.schedule import CatchUp, Schedule, ScheduleError, State
from results.database import StoreError, file_url

START = 1_795_000_000.0


def schedule(name="nightly", **changes):
    values = {"suite": "smoke", "cron": "*/10 * * * *", "created_at": START, **changes}
    return Schedule(name, **values)


@pytest.fixture
def book(tmp_path):
    opened = Book.open(file_url(tmp_path / "history.sqlite"))
    yield opened
    opened.close()


def folder(schedule, due_at):
    return f"/runs/{schedule.name}-{due_at:.0f}"


def test_a_schedule_comes_back_as_it_was(book):
    made = schedule(timezone="Europe/Berlin", arguments=("--seeds=3",), catch_up=CatchUp.ALL, keep=7, gate=False)
    book.add(made)
    assert book.schedules() == [made]
    assert book.find("nightly") == made
    with pytest.raises(ScheduleError, match="there is a schedule 'nightly' already"):
        book.add(made)


def test_removing_leaves_what_has_begun(book):
    book.add(schedule())
    book.take_note(START + 1800, folder)
    book.change(book.firings()[0], state=State.DONE, outcome="fine")
    assert book.remove("nightly")
    assert not book.remove("nightly")
    assert [one.outcome for one in book.firings()] == ["fine"]


@settings(max_examples=30)
@given(steps=st.lists(st.floats(0.0, 7200.0), min_size=1, max_size=8))
def test_however_often_it_is_asked_every_time_is_there_once(tmp_path_factory, steps):
    book = Book.open(file_url(tmp_path_factory.mktemp("book") / "history.sqlite"))
    made, now = schedule(), START
    book.add(made)
    for step in steps:
        now += step
        book.take_note(now, folder)
        book.take_note(now - 100, folder)  # a clock that was set back
    assert sorted(one.due_at for one in book.firings()) == list(made.due(START, now))
    book.close()


def test_several_processes_that_ask_at_once_write_each_time_once(book, tmp_path):
    book.add(schedule())
    books = [Book.open(file_url(tmp_path / "history.sqlite")) for _ in range(4)]
    noted = []

    def ask(own):
        for minute in range(0, 100, 7):
            noted.append(own.take_note(START + 60 * minute, folder))  # noqa: PERF401

    threads = [threading.Thread(target=ask, args=(own,)) for own in books]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    expected = list(schedule().due(START, START + 60 * 98))
    assert sorted(one.due_at for one in book.firings()) == expected
    assert sum(noted) == len(expected)
    for own in books:
        own.close()


def test_an_absence_of_years_is_looked_back_upon_for_a_month(book):
    book.add(schedule(cron="0 * * * *"))
    book.take_note(START + 3 * 365 * 86_400, folder)
    assert len(book.firings()) == 31 * 24


def test_a_newer_calendar_is_refused(tmp_path):
    path = tmp_path / "history.sqlite"
    Book.open(file_url(path)).close()
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE robogauntlet_calendar SET version = 9")
    connection.close()
    with pytest.raises(StoreError, match="calendar version 9, this program reads version 1"):
        Book.open(file_url(path))
