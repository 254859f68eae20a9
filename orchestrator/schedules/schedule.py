"""Schedules, scheduled runs, and the times of cron expressions."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from itertools import takewhile
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from cronsim import CronSim, CronSimError

from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.ranges import MAX_COUNT
from robogauntlet.support.errors import BadInput

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}")
SHORTHANDS = {
    "@hourly": "0 * * * *",
    "@daily": "0 0 * * *",
    "@midnight": "0 0 * * *",
    "@weekly": "0 0 * * 0",
    "@monthly": "0 0 1 * *",
    "@yearly": "0 0 1 1 *",
    "@annually": "0 0 1 1 *",
}
SCHEDULE_VARIABLE = "ROBOGAUNTLET_SCHEDULE"
"""Environment variable with the name of the schedule that starts a run."""
EXPECTED = (
    "expected five fields, such as '0 2 * * *' for every night at two: minute (0 to 59), hour (0 to 23), "
    "day of month (1 to 31), month (1 to 12, or jan to dec), day of week (0 to 7, or sun to sat)"
)


class ScheduleError(BadInput):
    """A schedule is invalid; the message says what was expected and what was given."""


class CatchUp(StrEnum):
    """What happens to runs that were due while no schedule server ran, or while an earlier run was in progress."""

    LATEST = "latest"
    """The last one is run; the others are missed."""
    ALL = "all"
    """All are run, one after the other."""
    SKIP = "skip"
    """All are missed."""


class State(StrEnum):
    """State of a scheduled run."""

    DUE = "due"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    """The run could not start, or stopped early: `outcome` says why."""
    MISSED = "missed"
    """The run was due and was not started."""


@dataclass(frozen=True)
class Schedule:
    """A suite that is run at given times."""

    name: str
    suite: str
    """A suite file (absolute), or the name of a shipped suite."""
    cron: str
    """Minute, hour, day of month, month, day of week, as cron(5) reads them."""
    timezone: str = "UTC"
    arguments: tuple[str, ...] = ()
    """Further arguments of `robogauntlet run`."""
    catch_up: CatchUp = CatchUp.LATEST
    keep: int | None = None
    """Number of run folders to keep; older ones are removed, their results stay in the history. None: all."""
    gate: bool = True
    """Whether each run is compared with the last good one."""
    created_at: float = 0.0
    """Seconds since 1970, UTC."""

    def due(self, after: float, until: float) -> Iterator[float]:
        """Return the due times after `after` and up to `until` (seconds since 1970, UTC)."""
        return takewhile(lambda moment: moment <= until, self._moments(after))

    def next_due(self, after: float) -> float:
        """Return the next due time (seconds since 1970, UTC). Raises ScheduleError."""
        return next(self._moments(after))

    def _moments(self, after: float) -> Iterator[float]:
        for moment in parsed(self.cron, datetime.fromtimestamp(after, _zone(self.timezone))):
            # Where an hour is repeated or skipped, the first moment may be past, or two may be equal.
            if moment.timestamp() > after:
                after = moment.timestamp()
                yield after


@dataclass(frozen=True)
class ScheduledRun:
    """One time at which a schedule was due, and its outcome."""

    schedule: str
    due_at: float
    """Seconds since 1970, UTC. With the schedule's name, its identity."""
    state: State
    folder: str
    """Run folder."""
    manual: bool = False
    """Whether a person started it, not the clock."""
    began_at: float | None = None
    ended_at: float | None = None
    outcome: str = ""
    """One line."""
    run_id: str | None = None
    """Id of the run, once the run has started."""


def checked(schedule: Schedule) -> Schedule:
    """Return the schedule if it is valid. Raises ScheduleError."""
    if not NAME.fullmatch(schedule.name):
        raise ScheduleError(
            f"name '{schedule.name}': expected letters, digits, '-' and '_', at most 63 and a letter or digit first"
        )
    if schedule.keep is not None and not 1 <= schedule.keep <= MAX_COUNT:
        raise ScheduleError(f"keep {schedule.keep}: expected 1 to {MAX_COUNT}, or nothing to keep all")
    schedule.next_due(0.0)
    return schedule


def parsed(cron: str, after: datetime) -> CronSim:
    """Return the times of a cron expression after a moment, by the rules of Debian's cron(8). Raises ScheduleError."""
    fields = expanded(cron)
    if not cron.isascii():
        raise ScheduleError(f"cron '{cron}': {EXPECTED}, in ASCII")
    try:
        times = CronSim(" ".join(fields), after)
    except CronSimError as error:
        raise ScheduleError(f"cron '{cron}': {error}; {EXPECTED}") from None
    if any(not isinstance(number, int) or number < 0 for number in times.days | times.weekdays):
        raise ScheduleError(f"cron '{cron}': L, LW and # are not supported; {EXPECTED}")
    return times


def expanded(cron: str) -> list[str]:
    """Return the five fields of a cron expression. Raises ScheduleError if it has more or fewer."""
    fields = SHORTHANDS.get(cron.strip().lower(), cron).split()
    if len(fields) != 5:
        raise ScheduleError(f"cron '{cron}': {EXPECTED}, got {len(fields)}")
    return fields


def _zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        expected = f"expected one of the IANA list such as Europe/Berlin{did_you_mean(name, available_timezones())}"
        raise ScheduleError(f"time zone '{name}': {expected}") from None
