"""The calendar in a real PostgreSQL server."""

import pytest

from orchestrator.calendar.book import Book
from orchestrator.calendar.schedule import CatchUp, Schedule, State
from orchestrator.calendar.serving import AlreadyServed, served_alone
from tests.results.test_store_postgresql import server  # noqa: F401

pytestmark = pytest.mark.slow
START = 1_795_000_000.0


def folder(schedule, due_at):
    return f"/runs/{schedule.name}-{due_at:.0f}"


def test_it_is_kept_and_served_by_one_process_at_a_time(server, tmp_path):  # noqa: F811
    book, other = Book.open(server), Book.open(server)
    made = Schedule("nightly", "smoke", "*/10 * * * *", "Europe/Berlin", ("--seeds=3",), CatchUp.ALL, 7, False, START)
    book.add(made)
    assert other.schedules() == [made]
    assert (book.take_note(START + 3600, folder), other.take_note(START + 3600, folder)) == (6, 0)
    firing = other.firings()[0]
    other.change(firing, state=State.DONE, outcome="fine")
    assert book.firings(state=State.DONE)[0].due_at == firing.due_at
    with served_alone(book.database, tmp_path):
        with pytest.raises(AlreadyServed, match="another process serves"), served_alone(other.database, tmp_path):
            pass
        assert "secret" not in book.database.where
    with served_alone(other.database, tmp_path):
        pass
    assert book.remove("nightly")
    book.close()
    other.close()
