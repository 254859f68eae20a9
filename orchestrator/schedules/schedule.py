"""Schedules: a YAML file of suites and the times at which they are run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Annotated
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from cronsim import CronSim, CronSimError
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.ranges import MAX_COUNT
from robogauntlet.suites.yaml_file import YamlError, parse_yaml, read_yaml
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


class Schedule(BaseModel):
    """A suite that is run at given times."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    name: str
    suite: str
    """A suite file (absolute), or the name of a shipped suite."""
    cron: str
    """Minute, hour, day of month, month, day of week, as cron(5) reads them."""
    timezone: str = "UTC"
    arguments: list[str] = []
    """Further arguments of `robogauntlet run`."""
    keep: Annotated[int | None, Field(ge=1, le=MAX_COUNT)] = None
    """Number of run folders to keep; older ones are removed, their results stay in the history. None: all."""
    gate: bool = True
    """Whether each run is compared with the last good one."""

    def next_due(self, after: float) -> float:
        """Return the next due time after a moment (seconds since 1970, UTC). Raises ScheduleError."""
        return next(self.due(after))

    def due(self, after: float) -> Iterator[float]:
        """Yield the due times after a moment (seconds since 1970, UTC). Raises ScheduleError."""
        for moment in parsed(self.cron, datetime.fromtimestamp(after, _zone(self.timezone))):
            # Where an hour is repeated or skipped, the first moment may be past, or two may be equal.
            if moment.timestamp() > after:
                after = moment.timestamp()
                yield after


def read_schedules(path: Path) -> list[Schedule]:
    """Return the schedules of a YAML file, a mapping of names; suite files are beside it.

    Raises:
        ScheduleError: It cannot be read, or a schedule is invalid.
    """
    try:
        document = parse_yaml(read_yaml(path, "a file of schedules"))
    except YamlError as error:
        raise ScheduleError(f"{path}: {error}") from None
    if document.duplicates:
        raise ScheduleError(f"{path}: schedule '{document.duplicates[0][1]}' is there twice")
    if not isinstance(document.data, dict) or not all(isinstance(one, dict) for one in document.data.values()):
        raise ScheduleError(f"{path}: expected a mapping, such as `nightly: {{suite: smoke, cron: '0 2 * * *'}}`")
    return [_schedule(path, name, values) for name, values in document.data.items()]


def _schedule(path: Path, name: object, values: dict[object, object]) -> Schedule:
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ScheduleError(
            f"{path}: name '{name}': expected letters, digits, '-' and '_', at most 63 and a letter or digit first"
        )
    try:
        schedule = Schedule.model_validate({**values, "name": name})
        schedule.next_due(0.0)
    except ValidationError as error:
        first = error.errors()[0]
        raise ScheduleError(f"{path}: {'.'.join(map(str, (name, *first['loc'])))}: {first['msg']}") from None
    except ScheduleError as error:
        raise ScheduleError(f"{path}: {name}: {error}") from None
    if Path(schedule.suite).suffix in (".yaml", ".yml"):
        return schedule.model_copy(update={"suite": str((path.parent / schedule.suite).resolve())})
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
