"""What is to run when: frozen values, and when a cron expression is due."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from suites.plugins import nearest

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}")
DAYS = ("sun", "mon", "tue", "wed", "thu", "fri", "sat")
SHORTHANDS = {
    "@hourly": "0 * * * *",
    "@daily": "0 0 * * *",
    "@midnight": "0 0 * * *",
    "@weekly": "0 0 * * 0",
    "@monthly": "0 0 1 * *",
    "@yearly": "0 0 1 1 *",
    "@annually": "0 0 1 1 *",
}


class ScheduleError(Exception):
    """A schedule that cannot be; the message says what was expected, what came and what to do."""


class CatchUp(StrEnum):
    """What becomes of runs that were due while nobody served the schedule, or while the run before went on."""

    LATEST = "latest"
    """The last of them is run, the others are missed."""
    ALL = "all"
    """All are run, one after the other."""
    SKIP = "skip"
    """All are missed."""


class State(StrEnum):
    """How far a firing is."""

    DUE = "due"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    """The run could not be begun, or stopped early: `outcome` says why."""
    MISSED = "missed"
    """It was due and was not run."""


@dataclass(frozen=True)
class Schedule:
    """A suite that is to run again and again."""

    name: str
    suite: str
    """A suite file (absolute), or the name of a shipped suite."""
    cron: str
    """Minute, hour, day of month, month, day of week, as cron(5) reads them."""
    timezone: str = "UTC"
    arguments: tuple[str, ...] = ()
    """Further arguments of `gauntlet run`."""
    catch_up: CatchUp = CatchUp.LATEST
    keep: int | None = None
    """Run folders that are kept; older ones are removed, their numbers stay in the history. None: all."""
    gate: bool = True
    """Whether each run is held against the last good one."""
    created_at: float = 0.0
    """Seconds since 1970, UTC."""

    def due(self, after: float, until: float) -> Iterator[float]:
        """Times at which it is due, later than `after` and not later than `until` (seconds since 1970, UTC)."""
        trigger = trigger_of(self.cron, self.timezone)
        moment = datetime.fromtimestamp(after, UTC) + timedelta(microseconds=1)
        while (found := trigger.get_next_fire_time(None, moment)) is not None and found.timestamp() <= until:
            yield found.timestamp()
            moment = found.astimezone(UTC) + timedelta(microseconds=1)

    def next_due(self, after: float) -> float | None:
        """The next time at which it is due (seconds since 1970, UTC), or None if never."""
        moment = datetime.fromtimestamp(after, UTC) + timedelta(microseconds=1)
        found = trigger_of(self.cron, self.timezone).get_next_fire_time(None, moment)
        return None if found is None else float(found.timestamp())


@dataclass(frozen=True)
class Firing:
    """One time at which a schedule was due, and what became of it."""

    schedule: str
    due_at: float
    """Seconds since 1970, UTC. With the schedule's name, its identity."""
    state: State
    folder: str
    """Of its run."""
    by_hand: bool = False
    """Asked for by a person, not by the clock."""
    began_at: float | None = None
    ended_at: float | None = None
    outcome: str = ""
    """What came of it, in a line."""
    run_id: str | None = None
    """The run, once it is known."""


def checked(schedule: Schedule) -> Schedule:
    """The same schedule, if it can be.

    Raises:
        ScheduleError: It cannot.
    """
    if not NAME.fullmatch(schedule.name):
        raise ScheduleError(
            f"name '{schedule.name}': expected letters, digits, '-' and '_', at most 63 and a letter or digit first"
        )
    if schedule.keep is not None and schedule.keep < 1:
        raise ScheduleError(f"keep {schedule.keep}: expected 1 or more, or nothing to keep all")
    trigger = trigger_of(schedule.cron, schedule.timezone)
    if trigger.get_next_fire_time(None, datetime.now(UTC)) is None:
        raise ScheduleError(f"cron '{schedule.cron}': there is no such day; it would never run")
    return schedule


def trigger_of(cron: str, timezone: str) -> Any:
    """APScheduler's trigger of a cron expression as cron(5) reads it.

    APScheduler counts weekdays from Monday and wants both day fields to match; cron counts them from Sunday and, where
    both are restricted, is content with one.

    Raises:
        ScheduleError: The expression or the time zone is wrong.
    """
    from apscheduler.triggers.combining import OrTrigger
    from apscheduler.triggers.cron import CronTrigger

    zone = _zone(timezone)
    fields = SHORTHANDS.get(cron.strip().lower(), cron).split()
    if len(fields) != 5:
        raise ScheduleError(
            f"cron '{cron}': expected five fields (minute, hour, day of month, month, day of week), got {len(fields)}; "
            "every night at two is '0 2 * * *'"
        )
    minute, hour, day, month, weekday = fields
    try:
        week = weekdays(weekday)

        def trigger(**days: str) -> Any:
            return CronTrigger(minute=minute, hour=hour, month=month, timezone=zone, **days)

        if day.startswith("*") or weekday.startswith("*"):
            return trigger(day=day, day_of_week=week)
        return OrTrigger([trigger(day=day), trigger(day_of_week=week)])
    except ValueError as error:
        raise ScheduleError(f"cron '{cron}': {str(error).splitlines()[0]}") from None


def _zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        near = nearest(name, sorted(available_timezones()))
        raise ScheduleError(
            f"time zone '{name}': expected one of the IANA list such as Europe/Berlin{near or ''}"
        ) from None


def weekdays(field: str) -> str:
    """Cron's weekdays (0 and 7 are Sunday) as names, or `*`. Raises ValueError."""
    if field == "*":
        return field
    found: set[int] = set()
    for part in field.lower().split(","):
        days, _, step = part.partition("/")
        if step and not (step.isdigit() and int(step)):
            raise ValueError(f"day of week '{field}': expected a step of 1 or more, got '{step}'")
        first, dash, last = days.partition("-")
        if days == "*":
            low, high = 0, 6
        else:
            low = _weekday(first, field)
            high = _weekday(last, field) if dash else (6 if step else low)
        if dash and high < low:
            high += 7
        found |= {day % 7 for day in range(low, high + 1, int(step or 1))}
    return ",".join(DAYS[day] for day in sorted(found))


def _weekday(word: str, field: str) -> int:
    if word in DAYS:
        return DAYS.index(word)
    if word.isdigit() and int(word) <= 7:
        return int(word)
    raise ValueError(f"day of week '{field}': expected 0 to 7 or sun to sat, got '{word}'")
