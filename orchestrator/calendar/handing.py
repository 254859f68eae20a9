"""Hands a schedule to what a group already uses: systemd timers, cron, GitHub Actions. Nothing is installed."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path

from orchestrator.calendar.schedule import DAYS, PARTS, Schedule, ScheduleError, expanded, numbers


class Target(StrEnum):
    """What is to begin the runs."""

    SYSTEMD = "systemd"
    CRON = "cron"
    GITHUB = "github"


def hand_over(schedule: Schedule, target: Target, root: Path) -> str:
    """The schedule in the words of another program.

    Args:
        schedule: What is to run when.
        target: For whom.
        root: Working directory of the runs.

    Raises:
        ScheduleError: It cannot be said in those words.
    """
    makers: dict[Target, Callable[[Schedule, Path], str]] = {
        Target.SYSTEMD: _systemd,
        Target.CRON: _cron,
        Target.GITHUB: _github,
    }
    return makers[target](schedule, root)


def _command(schedule: Schedule, gauntlet: str, folder: str) -> tuple[str, str | None]:
    """The commands of one run, for a shell: play, and hold it against the run before."""
    run = " ".join([gauntlet, "run", *map(shlex.quote, (schedule.suite, *schedule.arguments)), "--out", folder])
    return run, f"{gauntlet} gate {folder}" if schedule.gate else None


def _gauntlet() -> str:
    return shlex.quote(str(Path(sys.executable).with_name("gauntlet")))


def _cron(schedule: Schedule, root: Path) -> str:
    stamp = r"runs/" + schedule.name + r"-$(date -u +\%Y\%m\%d-\%H\%M\%S)"
    run, gate = _command(schedule, _gauntlet(), '"$RUN"')
    commands = f"cd {shlex.quote(str(root))} && RUN={stamp} && {run}" + (f" && {gate}" if gate else "")
    # Debian's cron knows no time zones but the machine's own.
    note = "# cronie reads CRON_TZ; where cron does not (Debian, Ubuntu), the machine's own time zone counts\n"
    return f"{note}CRON_TZ={schedule.timezone}\n{' '.join(expanded(schedule.cron))} {commands}\n"


def _systemd(schedule: Schedule, root: Path) -> str:
    run, gate = _command(schedule, _gauntlet(), '"$RUN"')
    # A per cent sign and a dollar sign have a meaning of their own in a unit.
    shell = f"RUN=runs/{schedule.name}-$(date -u +%Y%m%d-%H%M%S) && {run}" + (f" && {gate}" if gate else "")
    shell = shell.replace("%", "%%").replace("$", "$$")
    return "\n".join(
        [
            f"# /etc/systemd/system/gauntlet-{schedule.name}.service",
            "[Unit]",
            f"Description=RoboGauntlet: {schedule.name}",
            "",
            "[Service]",
            "Type=oneshot",
            f"WorkingDirectory={str(root).replace('%', '%%')}",
            f"ExecStart=/bin/sh -c {shlex.quote(shell)}",
            "",
            f"# /etc/systemd/system/gauntlet-{schedule.name}.timer",
            "[Unit]",
            f"Description=RoboGauntlet: {schedule.name}",
            "",
            "[Timer]",
            *(f"OnCalendar={line} {schedule.timezone}" for line in on_calendar(schedule.cron)),
            f"Persistent={'false' if schedule.catch_up == 'skip' else 'true'}",
            "",
            "[Install]",
            "WantedBy=timers.target",
            "",
        ]
    )


def on_calendar(cron: str) -> list[str]:
    """A cron expression as systemd's calendar events, one of which has to match. Raises ScheduleError."""
    fields = expanded(cron)
    minute, hour, day, month, weekday = (numbers(field, part, cron) for field, part in zip(fields, PARTS, strict=True))
    time = f"{hour}:{minute}:00"
    week = "" if weekday == "*" else ",".join(DAYS[int(number)].capitalize() for number in weekday.split(",")) + " "
    if fields[2].startswith("*") or fields[4].startswith("*"):
        return [f"{week}*-{month}-{day} {time}"]
    return [f"*-{month}-{day} {time}", f"{week}*-{month}-* {time}"]


def _github(schedule: Schedule, root: Path) -> str:
    """The workflow of `examples/github-nightly.yml`, with this schedule's time and arguments."""
    if schedule.timezone not in ("UTC", "Etc/UTC"):
        raise ScheduleError(
            f"time zone '{schedule.timezone}': GitHub runs schedules in UTC; add one with --timezone UTC"
        )
    template = (Path(__file__).parent / "github-nightly.yml").read_text(encoding="utf-8")
    suite = Path(schedule.suite)
    if suite.is_absolute():
        if not suite.is_relative_to(root):
            raise ScheduleError(f"suite {suite}: GitHub has only what is in the repository, expected it under {root}")
        suite = suite.relative_to(root)
    arguments = "".join(f" {shlex.quote(one)}" for one in schedule.arguments)
    return (
        template.replace("name: nightly gauntlet", f"name: {schedule.name}", 1)
        .replace('cron: "17 2 * * *"', f'cron: "{" ".join(expanded(schedule.cron))}"', 1)
        .replace("SUITE: suites/smoke.yaml", f"SUITE: {json.dumps(str(suite))}", 1)
        .replace('gauntlet run "$SUITE"', f'gauntlet run "$SUITE"{arguments}', 1)
    )
