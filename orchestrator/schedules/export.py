"""Renders schedules for systemd timers, cron and GitHub Actions. Nothing is installed."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from robogauntlet.orchestrator.schedules.schedule import Schedule, ScheduleError, expanded, parsed

DAYS = ("Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat")


class Target(StrEnum):
    """Program that starts the runs."""

    SYSTEMD = "systemd"
    CRON = "cron"
    GITHUB = "github"
    SERVICE = "service"
    """systemd, for the schedule server and the dashboard in place of a timer for each schedule."""


def render_all(schedules: Sequence[Schedule], target: Target, root: Path) -> str:
    """Render schedules as the configuration of another program, for runs in the working directory `root`.

    Raises:
        ScheduleError: The program cannot run one of these schedules.
    """
    if target is Target.SERVICE:
        return _service("schedules", "schedule serve", root) + "\n" + _service("dashboard", "serve", root)
    return "".join(render_for(schedule, target, root) for schedule in schedules)


def render_for(schedule: Schedule, target: Target, root: Path) -> str:
    """Render a schedule as the configuration of another program; see `render_all`."""
    return {Target.SYSTEMD: _systemd, Target.CRON: _cron, Target.GITHUB: _github}[target](schedule, root)


def _program() -> str:
    return str(Path(sys.executable).with_name("robogauntlet"))


def _cron(schedule: Schedule, root: Path) -> str:
    command = shlex.join([_program(), "schedule", "run-now", schedule.name])
    commands = f"cd {shlex.quote(str(root))} && {command}".replace("%", r"\%")
    # Debian's cron has only the machine's time zone.
    note = "# cronie reads CRON_TZ; other crons (Debian, Ubuntu) use the machine's time zone\n"
    note += "# variables of notifications (ROBOGAUNTLET_WEBHOOK_URL, ...) go above, a line each\n"
    return f"{note}CRON_TZ={schedule.timezone}\n{' '.join(expanded(schedule.cron))} {commands}\n"


def _systemd(schedule: Schedule, root: Path) -> str:
    events = "\n".join(f"OnCalendar={event} {schedule.timezone}" for event in on_calendar(schedule.cron))
    return f"""{_unit(schedule.name, root)}Type=oneshot
ExecStart={_words("schedule", "run-now", schedule.name)}

# /etc/systemd/system/robogauntlet-{schedule.name}.timer
[Unit]
Description=RoboGauntlet: {schedule.name}

[Timer]
{events}
Persistent={"false" if schedule.catch_up == "skip" else "true"}

[Install]
WantedBy=timers.target
"""


def _service(name: str, verb: str, root: Path) -> str:
    return f"""{_unit(name, root)}ExecStart={_words(*verb.split())}
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


def _words(*arguments: str) -> str:
    """A command of a unit, in which `%` and `$` are special."""
    return shlex.join([_program(), *arguments]).replace("%", "%%").replace("$", "$$")


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


def _github(schedule: Schedule, root: Path) -> str:
    """The workflow of `examples/github-nightly.yml` with the time and arguments of this schedule."""
    if schedule.timezone not in ("UTC", "Etc/UTC"):
        remedy = "GitHub runs schedules in UTC; add one with --timezone UTC"
        raise ScheduleError(f"time zone '{schedule.timezone}': {remedy}")
    template = (Path(__file__).parent / "github-nightly.yml").read_text(encoding="utf-8")
    suite = Path(schedule.suite)
    if suite.is_absolute():
        if not suite.is_relative_to(root):
            remedy = f"GitHub has only the files of the repository; expected the suite under {root}"
            raise ScheduleError(f"suite {suite}: {remedy}")
        suite = suite.relative_to(root)
    return (
        template.replace("name: nightly robogauntlet", f"name: {schedule.name}", 1)
        .replace('cron: "17 2 * * *"', f'cron: "{" ".join(expanded(schedule.cron))}"', 1)
        .replace("suite: suites/smoke.yaml", f"suite: {json.dumps(str(suite))}", 1)
        .replace('arguments: ""', f"arguments: {json.dumps(shlex.join(schedule.arguments))}", 1)
    )
