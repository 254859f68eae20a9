"""`robogauntlet schedule`."""

import re
import subprocess

import pytest

from robogauntlet.orchestrator.cli import schedule as verb
from robogauntlet.orchestrator.schedules.runner import Outcome, Runner

SUITE = "name: nulls\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 5}\nworkers: 1\n"


@pytest.fixture
def write(tmp_path):
    """Writes a file of one schedule with these values."""
    (tmp_path / "nulls.yaml").write_text(SUITE)

    def write(text="suite: nulls.yaml, cron: '15 2 * * 1-5', timezone: Europe/Berlin, arguments: [--no-media]"):
        (tmp_path / "schedules.yaml").write_text(f"nightly: {{{text}}}\n")

    write()
    return write


def test_schedules_are_listed_with_their_next_time(run_command, write):
    shown = run_command("schedule", "list").out
    assert "15 2 * * 1-5 Europe/Berlin" in shown
    assert re.search(r"20\d\d-\d\d-\d\d 0[01]:15 UTC", shown)


@pytest.mark.parametrize(("is_good", "code"), [(True, 0), (False, 1)])
def test_run_ends_with_the_code_of_the_outcome(run_command, write, monkeypatch, is_good, code):
    monkeypatch.setattr(Runner, "play", lambda self, schedule: Outcome("so", "run-1", is_good))
    assert run_command("schedule", "run", "nightly").code == code


def test_serve_says_what_it_serves(run_command, write, monkeypatch, tmp_path):
    monkeypatch.delenv("ROBOGAUNTLET_WEBHOOK_URL", raising=False)
    served = []
    monkeypatch.setattr(verb.Runner, "serve", lambda self, schedules: served.extend(schedules))
    assert "serving nightly; notifications go to this log only" in run_command("schedule", "serve").out
    assert [schedule.suite for schedule in served] == [str(tmp_path / "nulls.yaml")]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ("suite: nulls.yaml, cron: '0 2 * *'", "schedules.yaml: nightly: cron '0 2 * *': expected five fields"),
        ("suite: nulls.yaml, cron: '0 25 * * *'", "Bad hour; expected five fields"),
        ("suite: nulls.yaml, cron: '@daily', timezone: Berlin", "time zone 'Berlin': expected one"),
        ("suite: nosuite, cron: '@daily'", "nosuite"),
        ("suite: missing.yaml, cron: '@daily'", "missing.yaml"),
    ],
)
@pytest.mark.parametrize("command", [("list",), ("print", "cron"), ("run", "nightly"), ("serve",)])
def test_a_mistake_in_the_file_is_one_line(run_command, write, tmp_path, command, values, words):
    write(values)
    assert words in run_command("schedule", *command).refusal
    assert not (tmp_path / "runs").exists()


def test_an_unknown_schedule_and_a_missing_recipient_are_one_line(run_command, write, monkeypatch):
    for name in ("ROBOGAUNTLET_WEBHOOK_URL", "ROBOGAUNTLET_SMTP_HOST"):
        monkeypatch.delenv(name, raising=False)
    assert "no schedule 'nightl'; did you mean 'nightly'?" in run_command("schedule", "run", "nightl").refusal
    assert "no recipient: set ROBOGAUNTLET_WEBHOOK_URL" in run_command("schedule", "list", "--test-message").refusal


def test_cron_gets_a_line_whose_command_is_a_shell_command(run_command, write, tmp_path):
    *notes, zone, line = run_command("schedule", "print", "cron").out.splitlines()
    assert all(note.startswith("# ") for note in notes)
    assert zone == "CRON_TZ=Europe/Berlin"
    assert line.startswith("15 2 * * 1-5 cd ")
    command = line.partition("1-5 ")[2].replace(r"\%", "%")
    assert subprocess.run(["sh", "-n", "-c", command], check=False).returncode == 0
    assert command.endswith(f"schedule run nightly {tmp_path}/schedules.yaml")


def test_systemd_gets_a_service_and_a_timer(run_command, write, tmp_path):
    text = run_command("schedule", "print", "systemd").out
    assert "OnCalendar=Mon,Tue,Wed,Thu,Fri *-*-* 2:15:00 Europe/Berlin\n" in text
    assert "Persistent=true" in text
    (started,) = re.findall("ExecStart=(.*)", text)
    assert started.endswith(f"/robogauntlet schedule run nightly {tmp_path}/schedules.yaml")
    assert "\nEnvironmentFile=-/" in text


def test_systemd_gets_services_for_the_schedule_server_and_the_dashboard(run_command, write, tmp_path):
    text = run_command("schedule", "print", "service").out
    served = f"schedule serve {tmp_path}/schedules.yaml"
    assert re.findall("ExecStart=.*/robogauntlet (.*)", text) == [served, "serve dashboard"]
    assert text.count(f"WorkingDirectory={tmp_path}\n") == text.count("Restart=on-failure\n") == 2
