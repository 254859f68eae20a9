"""Promises of orchestrator/schedules/schedule.py: cron expressions as cron(5) reads them."""

import json
import re
from datetime import UTC, datetime, timedelta
from itertools import takewhile
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.orchestrator.schedules.schedule import Schedule, ScheduleError, read_schedules
from robogauntlet.orchestrator.schedules.units import Target, render_all

START = datetime(2026, 11, 1, tzinfo=UTC)


def schedule(cron, **changes):
    return Schedule(name="nightly", suite="smoke", cron=cron, **changes)


def due(schedule, after, until):
    return list(takewhile(lambda moment: moment <= until, schedule.due(after)))


def moments(cron, days, timezone="UTC"):
    after = START.timestamp()
    found = due(schedule(cron, timezone=timezone), after, after + 86_400 * days)
    return [datetime.fromtimestamp(moment, UTC) for moment in found]


def members(field, low, high):
    """The numbers that a field of cron(5) names."""
    found = set()
    for part in field.split(","):
        span, _, step = part.partition("/")
        first, dash, last = span.partition("-")
        if span == "*":
            numbers = range(low, high + 1)
        elif dash:
            numbers = range(int(first), int(last) + 1)
        else:
            numbers = range(int(first), (high if step else int(first)) + 1)
        found |= set(numbers[:: int(step or 1)])
    return found


def matches(cron, moment):
    """As cron(5) defines it, minute by minute."""
    minute, hour, day, month, weekday = cron.split()
    in_time = moment.minute in members(minute, 0, 59) and moment.hour in members(hour, 0, 23)
    by_day = moment.day in members(day, 1, 31)
    by_week = moment.isoweekday() % 7 in {number % 7 for number in members(weekday, 0, 6)}
    either = not (day.startswith("*") or weekday.startswith("*"))
    return in_time and moment.month in members(month, 1, 12) and (by_day or by_week if either else by_day and by_week)


def fields(low, high):
    number = st.integers(low, high)
    ranges = st.lists(number, min_size=2, max_size=2, unique=True).map(sorted).map("{0[0]}-{0[1]}".format)
    steps = st.builds("{}/{}".format, st.one_of(st.just("*"), ranges), st.integers(1, 5))
    part = st.one_of(number.map(str), ranges, steps)
    return st.one_of(st.just("*"), st.lists(part, min_size=1, max_size=2).map(",".join))


@settings(max_examples=40)
@given(minute=st.integers(0, 59), hour=fields(0, 23), day=fields(1, 31), month=fields(1, 12), weekday=fields(0, 6))
def test_due_times_are_exactly_those_of_the_cron_expression(minute, hour, day, month, weekday):
    cron = f"{minute} {hour} {day} {month} {weekday}"
    days = 45
    hours = (START + timedelta(hours=h, minutes=minute) for h in range(24 * days + 1))
    expected = [m for m in hours if START < m <= START + timedelta(days=days) and matches(cron, m)]
    assert moments(cron, days) == expected


@pytest.mark.parametrize(("weekday", "names"), [("0", "Sun"), ("7", "Sun"), ("1", "Mon"), ("fri", "Fri"), ("6", "Sat")])
def test_weekdays_are_counted_from_sunday(weekday, names):
    assert {f"{moment:%a}" for moment in moments(f"0 2 * * {weekday}", 21)} == {names}


def test_shorthands_are_understood():
    assert [m.hour for m in moments("@daily", 3)] == [0, 0, 0]


def test_the_hour_is_that_of_the_time_zone_in_summer_and_winter():
    summer = datetime(2026, 10, 24, tzinfo=UTC).timestamp()
    found = due(schedule("0 2 * * *", timezone="America/New_York"), summer, summer + 12 * 86_400)
    assert {datetime.fromtimestamp(m, UTC).hour for m in found} == {6, 7}


@pytest.mark.parametrize("cron", ["30 2 * * *", "0,30 2 * * *", "15 2-3 * * *"])
def test_a_skipped_or_repeated_hour_is_due_once(cron):
    zone = ZoneInfo("Europe/Berlin")
    for day in (datetime(2026, 3, 29, tzinfo=zone), datetime(2026, 10, 25, tzinfo=zone)):
        start = day.timestamp()
        found = due(schedule(cron, timezone="Europe/Berlin"), start, start + 86_400)
        assert found == sorted(set(found))
        local = [datetime.fromtimestamp(moment, zone) for moment in found]
        assert len({f"{moment:%H:%M}" for moment in local}) == len(found) > 0
        for minute in range(0, 6 * 60, 7):
            after = start + 60 * minute
            later = due(schedule(cron, timezone="Europe/Berlin"), after, start + 86_400)
            assert later == [moment for moment in found if moment > after]


def test_an_hourly_schedule_is_due_twice_in_a_repeated_hour():
    start = datetime(2026, 10, 24, 23, 30, tzinfo=UTC).timestamp()
    assert len(due(schedule("0 * * * *", timezone="Europe/Berlin"), start, start + 3 * 3600)) == 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cron": "0 2 * *"}, r"expected five fields, such as '0 2 \* \* \*' .*, got 4"),
        ({"cron": "0 0 2 * * *"}, "expected five fields, .*, got 6"),
        ({"cron": "61 2 * * *"}, r"cron '61 2 \* \* \*': Bad minute; expected .* minute \(0 to 59\)"),
        ({"cron": "0 2 * * 8"}, r"Bad day-of-week; .* \(0 to 7, or sun to sat\)"),
        ({"cron": "0 2 * * fri-mon"}, "Bad day-of-week"),
        ({"cron": "0 2 * * mon/0"}, "Bad day-of-week"),
        ({"cron": "0 2 * * mon#1"}, r"L, LW and # are not supported"),
        ({"cron": "x 2 * * *"}, "cron 'x 2"),
        ({"cron": "0 2 30 2 *"}, "Bad day-of-month"),
        ({"timezone": "Europe/Berln"}, "did you mean 'Europe/Berlin'"),
        ({"timezone": "../../etc/passwd"}, "expected one of the IANA list"),
        ({"keep": 0}, "nightly.keep: Input should be greater than or equal to 1"),
        ({"keep": 10**19}, "nightly.keep: Input should be less than or equal to 1000000000"),
        ({"suite": 5}, "nightly.suite: Input should be a valid string"),
        ({"sute": "smoke"}, "nightly.sute: Extra inputs are not permitted"),
        ({"cron": "\u0663 * * * *"}, "expected five fields, .*, in ASCII"),
    ],
)
def test_an_invalid_schedule_is_one_line_with_what_was_expected(tmp_path, changes, words):
    values = {"suite": "smoke", "cron": "0 2 * * *", **changes}
    file = tmp_path / "schedules.yaml"
    file.write_text(json.dumps({"nightly": values}))
    with pytest.raises(ScheduleError, match=words) as caught:
        read_schedules(file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nightly: smoke", "expected a mapping, such as"),
        ("[]", "expected a mapping, such as"),
        ("a/b: {suite: smoke, cron: '@daily'}", "name 'a/b': expected letters, digits"),
        ("n: {suite: smoke, cron: '@daily'}\nn: {suite: smoke, cron: '@daily'}", "schedule 'n' is there twice"),
        ("n: {suite: smoke}", "n.cron: Field required"),
        ("n: {", "not YAML"),
    ],
)
def test_a_file_of_another_form_is_one_line(tmp_path, text, words):
    file = tmp_path / "schedules.yaml"
    file.write_text(text)
    with pytest.raises(ScheduleError, match=re.escape(words)) as caught:
        read_schedules(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_a_suite_file_is_beside_the_schedules_and_a_shipped_suite_is_named(tmp_path):
    file = tmp_path / "schedules.yaml"
    file.write_text("one: {suite: a.yaml, cron: '@daily', keep: 3, gate: false}\ntwo: {suite: smoke, cron: '@daily'}")
    one, two = read_schedules(file)
    assert (one.suite, one.keep, one.gate) == (str(tmp_path / "a.yaml"), 3, False)
    assert (two.suite, two.keep, two.gate) == ("smoke", None, True)


def test_a_percent_sign_in_a_path_is_escaped_for_cron(tmp_path):
    line = render_all([schedule("0 2 * * *")], Path("/a%b.yaml"), Target.CRON, tmp_path / "x%y").splitlines()[-1]
    assert "%" in line
    assert line.replace(r"\%", "").count("%") == 0
