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
MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
SHORTHANDS = {
    "@hourly": "0 * * * *",
    "@daily": "0 0 * * *",
    "@midnight": "0 0 * * *",
    "@weekly": "0 0 * * 0",
    "@monthly": "0 0 1 * *",
    "@yearly": "0 0 1 1 *",
    "@annually": "0 0 1 1 *",
}


@dataclass(frozen=True)
class Part:
    """One of the five fields of a cron expression."""

    name: str
    low: int
    high: int
    names: tuple[str, ...] = ()
    """Of the numbers from `low` on."""
    cycle: int | None = None
    """After so many numbers the first comes again, and a range may go over the end."""

    def number(self, word: str, field: str, cron: str) -> int:
        """A number or name. Raises ScheduleError."""
        if word in self.names:
            return self.low + self.names.index(word)
        most = self.high if self.cycle is None else self.cycle
        if word.isdecimal() and self.low <= int(word) <= most:
            return int(word)
        known = f"{self.low} to {most}" + (f" or {self.names[0]} to {self.names[-1]}" if self.names else "")
        raise ScheduleError(f"cron '{cron}': {self.name} '{field}': expected {known}, got '{word}'")


PARTS = (
    Part("minute", 0, 59),
    Part("hour", 0, 23),
    Part("day of month", 1, 31),
    Part("month", 1, 12, MONTHS),
    Part("day of week", 0, 6, DAYS, cycle=7),
)


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
        for moment in self._moments(after):
            if moment > until:
                return
            yield moment

    def next_due(self, after: float) -> float | None:
        """The next time at which it is due (seconds since 1970, UTC), or None if never."""
        return next(self._moments(after), None)

    def _moments(self, after: float) -> Iterator[float]:
        trigger = trigger_of(self.cron, self.timezone)
        moment = datetime.fromtimestamp(after, UTC) + timedelta(microseconds=1)
        once = not expanded(self.cron)[1].startswith("*")
        while (found := trigger.get_next_fire_time(None, moment)) is not None:
            # At the end of summer an hour comes twice. What is due at certain hours is not due in the second.
            if not (once and found.fold):
                yield float(found.timestamp())
            moment = found.astimezone(UTC) + timedelta(microseconds=1)


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
    fields = expanded(cron)
    minute, hour, day, month, weekday = (numbers(field, part, cron) for field, part in zip(fields, PARTS, strict=True))
    week = "*" if weekday == "*" else ",".join(DAYS[int(number)] for number in weekday.split(","))

    def trigger(**days: str) -> Any:
        return CronTrigger(minute=minute, hour=hour, month=month, timezone=zone, **days)

    if fields[2].startswith("*") or fields[4].startswith("*"):
        return trigger(day=day, day_of_week=week)
    return OrTrigger([trigger(day=day), trigger(day_of_week=week)])


def expanded(cron: str) -> list[str]:
    """The five fields of a cron expression.

    Raises:
        ScheduleError: There are more or fewer.
    """
    fields = SHORTHANDS.get(cron.strip().lower(), cron).split()
    if len(fields) != len(PARTS):
        raise ScheduleError(
            f"cron '{cron}': expected five fields (minute, hour, day of month, month, day of week), got {len(fields)}; "
            "every night at two is '0 2 * * *'"
        )
    return fields


def _zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        near = nearest(name, sorted(available_timezones()))
        raise ScheduleError(
            f"time zone '{name}': expected one of the IANA list such as Europe/Berlin{near or ''}"
        ) from None


def numbers(field: str, part: Part, cron: str) -> str:
    """A field of a cron expression as `*`, or as numbers with commas between. Sunday is 0.

    Raises:
        ScheduleError: It is no such field.
    """
    if field == "*":
        return field
    found: set[int] = set()
    for piece in field.lower().split(","):
        span, slash, step = piece.partition("/")
        if slash and not (step.isdecimal() and int(step)):
            raise ScheduleError(f"cron '{cron}': {part.name} '{field}': expected a step of 1 or more, got '{step}'")
        first, dash, last = span.partition("-")
        if span == "*":
            low, high = part.low, part.high
        else:
            low = part.number(first, field, cron)
            high = part.number(last, field, cron) if dash else (part.high if slash else low)
        if high < low:
            if part.cycle is None:
                raise ScheduleError(f"cron '{cron}': {part.name} '{field}': expected the lower number first")
            high += part.cycle
        found |= {n if part.cycle is None else n % part.cycle for n in range(low, high + 1, int(step or 1))}
    return ",".join(map(str, sorted(found)))
