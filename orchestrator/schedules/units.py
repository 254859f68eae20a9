"""Schedules as units of systemd and lines of cron."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from robogauntlet.orchestrator.schedules.schedule import Schedule, expanded, parsed

DAYS = ("Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat")


class Target(StrEnum):
    """Program that starts the runs."""

    SYSTEMD = "systemd"
    CRON = "cron"
    SERVICE = "service"
    """systemd, for the schedule server and the dashboard in place of a timer for each schedule."""


def render_all(schedules: Sequence[Schedule], file: Path, target: Target, root: Path) -> str:
    """Render the schedules of a file for another program, for runs in the working directory `root`."""
    if target is Target.SERVICE:
        served = _service("schedules", ("schedule", "serve", str(file)), root)
        return f"{served}\n{_service('dashboard', ('serve', 'dashboard'), root)}"
    render = _systemd if target is Target.SYSTEMD else _cron
    return "".join(render(schedule, ("schedule", "run", schedule.name, str(file)), root) for schedule in schedules)


def _program() -> str:
    return str(Path(sys.executable).with_name("robogauntlet"))


def _cron(schedule: Schedule, words: Sequence[str], root: Path) -> str:
    commands = f"cd {shlex.quote(str(root))} && {shlex.join([_program(), *words])}".replace("%", r"\%")
    # Debian's cron has only the machine's time zone.
    note = "# cronie reads CRON_TZ; other crons (Debian, Ubuntu) use the machine's time zone\n"
    note += "# variables of notifications (ROBOGAUNTLET_WEBHOOK_URL, ...) go above, a line each\n"
    return f"{note}CRON_TZ={schedule.timezone}\n{' '.join(expanded(schedule.cron))} {commands}\n"


def _systemd(schedule: Schedule, words: Sequence[str], root: Path) -> str:
    events = "\n".join(f"OnCalendar={event} {schedule.timezone}" for event in on_calendar(schedule.cron))
    return f"""{_unit(schedule.name, root)}Type=oneshot
ExecStart={_words(words)}

# /etc/systemd/system/robogauntlet-{schedule.name}.timer
[Unit]
Description=RoboGauntlet: {schedule.name}

[Timer]
{events}
Persistent=true

[Install]
WantedBy=timers.target
"""


def _service(name: str, words: Sequence[str], root: Path) -> str:
    return f"""{_unit(name, root)}ExecStart={_words(words)}
KillSignal=SIGINT
Restart=on-failure

[Install]
WantedBy=multi-user.target
"""


def _unit(name: str, root: Path) -> str:
    """The first lines of a service; a file that is missing holds no variables."""
    return f"""# /etc/systemd/system/robogauntlet-{name}.service
# add User=NAME; variables of notifications and tokens go into the file, which only its owner should read
[Unit]
Description=RoboGauntlet: {name}

[Service]
WorkingDirectory={str(root).replace("%", "%%")}
EnvironmentFile=-/etc/robogauntlet/environment
"""


def _words(words: Sequence[str]) -> str:
    """A command of a unit, in which `%` and `$` are special."""
    return shlex.join([_program(), *words]).replace("%", "%%").replace("$", "$$")


def on_calendar(cron: str) -> list[str]:
    """Convert a cron expression into systemd's calendar events, one of which must match. Raises ScheduleError."""
    fields, times = expanded(cron), parsed(cron, datetime.now(UTC))
    numbers = [times.minutes, times.hours, times.days, times.months]
    minute, hour, day, month = (
        field if field == "*" else ",".join(map(str, sorted(values)))
        for field, values in zip(fields, numbers, strict=False)
    )
    weekdays = sorted({number % 7 for number in times.weekdays if isinstance(number, int)})
    week = "" if fields[4] == "*" else ",".join(DAYS[number] for number in weekdays) + " "
    if times.day_and:
        return [f"{week}*-{month}-{day} {hour}:{minute}:00"]
    return [f"*-{month}-{day} {hour}:{minute}:00", f"{week}*-{month}-* {hour}:{minute}:00"]
