"""Clocks that are wrong, pauses and daylight saving neither flood nor starve a schedule."""

from datetime import datetime
from zoneinfo import ZoneInfo

import pytest

from robogauntlet.orchestrator.schedules.schedule import Schedule, State
from robogauntlet.orchestrator.schedules.server import Server
from robogauntlet.orchestrator.schedules.store import MAX_DUE, ScheduleStore
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.run_history import History

START = 1_795_000_000.0
DAY = 86_400.0
YEARS = 10 * 365 * DAY


class Clockwork:
    """A server whose clock the test sets; runs are concluded at once instead of being played."""

    def __init__(self, folder):
        self.url = file_url(folder / "history.sqlite")
        self.store, self.history = ScheduleStore.open(self.url), History.open(self.url)
        self.now, self.sent, self.log, self.started = START, [], [], []
        options = {"send": self.sent.append, "log": self.log.append, "now": lambda: self.now}
        self.server = Server(self.store, self.history, folder, **options)
        self.server._begin = self._begin

    def _begin(self, schedule, scheduled_run):
        self.started.append(scheduled_run.due_at)
        self.store.change(scheduled_run, state=State.DONE)

    def add(self, **changes):
        values = {"cron": "0 2 * * *", "created_at": START, **changes}
        self.store.add(Schedule("nightly", "smoke", **values))

    def nights(self, count):
        """Serve for days, once an hour; return how many runs were started."""
        before = len(self.started)
        for _ in range(count * 24):
            self.now += 3600.0
            self.server.step()
        return len(self.started) - before


@pytest.fixture
def clockwork(tmp_path):
    made = Clockwork(tmp_path)
    yield made
    made.store.close()
    made.history.close()


def test_a_schedule_goes_on_after_a_clock_that_was_ten_years_ahead(clockwork):
    clockwork.add()
    assert clockwork.nights(2) == 2
    clockwork.now += YEARS
    clockwork.server.step()
    assert len(clockwork.started) <= 3
    clockwork.now -= YEARS
    clockwork.sent.clear()
    assert clockwork.nights(3) == 3
    assert [message.title for message in clockwork.sent] == ["CLOCK: nightly is served again"]


def test_runs_due_in_the_future_are_forgotten_when_the_clock_is_right(clockwork):
    clockwork.add()
    clockwork.store.record_due(START + YEARS, clockwork.server.folder)  # and the server is stopped before any starts
    clockwork.server.step()
    assert clockwork.started == []
    assert clockwork.store.scheduled_runs(state=State.DUE) == []


def test_a_clock_that_is_some_minutes_ahead_repeats_no_run(clockwork):
    clockwork.add(cron="*/10 * * * *")
    clockwork.now = START + 1800.0
    clockwork.server.step()
    clockwork.now = START + 600.0
    clockwork.server.step()
    assert len(clockwork.started) == 1
    assert clockwork.log == [line for line in clockwork.log if "clock" not in line]


def test_a_schedule_of_every_minute_is_run_once_after_a_month(clockwork):
    clockwork.add(cron="* * * * *")
    clockwork.now = START + 31 * DAY
    clockwork.server.step()
    clockwork.server.step()
    assert len(clockwork.started) == 1
    assert clockwork.now - clockwork.started[0] < 60.0
    assert len(clockwork.store.scheduled_runs()) == MAX_DUE
    assert len(clockwork.sent) == 1


@pytest.mark.parametrize("month_and_day", [(3, 27), (10, 30)])
def test_a_night_when_the_clock_changes_has_one_run(clockwork, month_and_day):
    begin = datetime(2027, *month_and_day, 12, tzinfo=ZoneInfo("Europe/Berlin")).timestamp()
    clockwork.now = begin
    clockwork.add(cron="30 2 * * *", timezone="Europe/Berlin", created_at=begin)
    assert clockwork.nights(1) == 1
    assert clockwork.nights(1) == 1
