"""`robogauntlet schedule`."""

import re
import subprocess
import time
from contextlib import closing, contextmanager
from dataclasses import replace

import pytest

from robogauntlet.orchestrator.cli import schedule as schedule_verb
from robogauntlet.orchestrator.schedules.schedule import Schedule, State
from robogauntlet.orchestrator.schedules.server import Server, exclusive_server
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.report.history_plot import when
from robogauntlet.results.store.database import file_url
from tests import ROOT

SUITE = "name: nulls\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 5}\nworkers: 1\n"


@pytest.fixture
def suite(tmp_path):
    (tmp_path / "nulls.yaml").write_text(SUITE)


def test_a_schedule_is_added_listed_and_removed(run_command, suite):
    added = run_command(
        "schedule", "add", "nightly", "nulls.yaml", "--cron", "0 2 * * *", "--timezone", "Europe/Berlin"
    )
    assert re.fullmatch(r"nightly: 5 episodes of nulls, next at 20\d\d-\d\d-\d\d 0[01]:00 UTC\n", added.out)
    assert "0 2 * * * Europe/Berlin" in run_command("schedule", "list").out
    assert run_command("schedule", "remove", "nightly").out == "nightly: removed, its runs stay\n"
    assert "no schedule yet" in run_command("schedule", "list").out


@pytest.mark.ray
def test_run_now_plays_checks_and_records_a_run(run_command, suite):
    run_command("schedule", "add", "nightly", "nulls.yaml", "--cron", "@daily", "--no-media")
    result = run_command("schedule", "run-now", "nightly")
    assert result.code == 0, result.err
    assert "nightly: done, 100 % [57, 100], 5 episodes; the first of its suite" in result.out
    assert "done: 100 % [57, 100], 5 episodes" in run_command("schedule", "list").out
    assert "nulls" in run_command("history").out


def test_run_now_runs_what_another_asked_for_meanwhile(run_command, suite, monkeypatch, tmp_path):
    for name in ("one", "two"):
        run_command("schedule", "add", name, "nulls.yaml", "--cron", "@daily")
    played = []

    def play(server, schedule, run):
        if not played:  # another process finds the lock taken and leaves its run to this one
            server._store.trigger_now(server._store.find("two"), run.due_at, lambda *_: "other")
        played.append(schedule.name)
        server._store.change(run, state=State.DONE)
        return replace(run, state=State.DONE)

    monkeypatch.setattr(Server, "play", play)
    assert run_command("schedule", "run-now", "one").code == 0
    assert played == ["one", "two"]


def test_run_now_is_seen_by_a_process_that_is_about_to_end(run_command, suite, monkeypatch):
    run_command("schedule", "add", "nightly", "nulls.yaml", "--cron", "@daily")
    played = []

    @contextmanager
    def ending(database, root):
        """Another process plays what it finds before it releases the lock."""
        (run,) = (store := ScheduleStore(database)).scheduled_runs(state=State.DUE)
        store.change(run, state=State.DONE, outcome="by another")
        yield

    monkeypatch.setattr(schedule_verb, "exclusive_server", ending)
    monkeypatch.setattr(Server, "play", lambda *arguments: played.append(arguments))
    assert "nightly: done, by another" in run_command("schedule", "run-now", "nightly").out
    assert played == []


def test_run_now_leaves_the_run_to_a_running_server(run_command, suite, tmp_path):
    run_command("schedule", "add", "nightly", "nulls.yaml", "--cron", "@daily")
    schedule_store = ScheduleStore.open(file_url(tmp_path / "runs" / "history.sqlite"))
    with exclusive_server(schedule_store.database, tmp_path / "runs"):
        result = run_command("schedule", "run-now", "nightly")
        assert "the running schedule server starts it" in result.out
        assert [scheduled_run.manual for scheduled_run in schedule_store.scheduled_runs()] == [True]
        assert "another schedule server runs on" in run_command("schedule", "serve").refusal
    schedule_store.close()


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("add", "n", "nulls.yaml", "--cron", "0 2 * *"), "expected five fields"),
        (("add", "n", "nulls.yaml", "--cron", "0 25 * * *"), "Bad hour; expected five fields"),
        (("add", "n", "nulls.yaml", "--cron", "@daily", "--timezone", "Berlin"), "time zone 'Berlin': expected one"),
        (("add", "n", "nosuite", "--cron", "@daily"), "nosuite"),
        (("add", "n", "missing.yaml", "--cron", "@daily"), "missing.yaml"),
        (("add", "n", "nulls.yaml", "--cron", "@daily", "--policy", "orcle"), "orcle"),
        (("add", "a/b", "nulls.yaml", "--cron", "@daily"), "name 'a/b': expected letters"),
        (("remove", "nothing"), "no schedule 'nothing'"),
        (("run-now", "nothing"), "no schedule 'nothing'"),
        (("test-message",), "no recipient: set ROBOGAUNTLET_WEBHOOK_URL"),
    ],
)
def test_a_mistake_is_one_line(run_command, suite, monkeypatch, typed, words):
    for name in ("ROBOGAUNTLET_WEBHOOK_URL", "ROBOGAUNTLET_SMTP_HOST"):
        monkeypatch.delenv(name, raising=False)
    assert words in run_command("schedule", *typed).refusal
    assert "no schedule yet" in run_command("schedule", "list").out


def test_a_name_can_be_used_once(run_command, suite):
    run_command("schedule", "add", "nightly", "nulls.yaml", "--cron", "@daily")
    again = run_command("schedule", "add", "nightly", "nulls.yaml", "--cron", "@hourly")
    assert "schedule 'nightly' exists" in again.refusal


def printed(run_command, target, cron="15 2 * * 1-5", **options):
    more = [part for name, value in options.items() for part in (f"--{name}", value)]
    run_command("schedule", "add", "nightly", "nulls.yaml", "--cron", cron, "--no-media", *more)
    return run_command("schedule", "list", "--print", target)


def test_cron_gets_a_line_whose_command_is_a_shell_command(run_command, suite, tmp_path):
    text = printed(run_command, "cron").out
    *notes, zone, line = text.splitlines()
    assert all(note.startswith("# ") for note in notes)
    assert zone == "CRON_TZ=UTC"
    assert line.startswith("15 2 * * 1-5 cd ")
    command = line.partition("1-5 ")[2].replace(r"\%", "%")
    assert subprocess.run(["sh", "-n", "-c", command], check=False).returncode == 0
    assert command.endswith("schedule run-now nightly")


def test_systemd_gets_a_service_and_a_timer(run_command, suite):
    text = printed(run_command, "systemd", timezone="Europe/Berlin").out
    assert "OnCalendar=Mon,Tue,Wed,Thu,Fri *-*-* 2:15:00 Europe/Berlin\n" in text
    assert "Persistent=true" in text
    (started,) = re.findall("ExecStart=(.*)", text)
    assert started.endswith("/robogauntlet schedule run-now nightly")
    assert "\nEnvironmentFile=-/" in text


def test_systemd_gets_services_for_the_schedule_server_and_the_dashboard(run_command, tmp_path):
    text = run_command("schedule", "list", "--print", "service").out
    assert re.findall("ExecStart=.*/robogauntlet (.*)", text) == ["schedule serve", "serve"]
    assert text.count(f"WorkingDirectory={tmp_path}\n") == text.count("Restart=on-failure\n") == 2


def test_a_list_says_that_nobody_serves_the_schedules_and_what_was_due_meanwhile(run_command, suite, tmp_path):
    run_command("schedule", "add", "nightly", "nulls.yaml", "--cron", "*/10 * * * *")
    remedy = "; start one: robogauntlet schedule serve\n"
    assert run_command("schedule", "list").err == f"robogauntlet: no process serves the schedules{remedy}"
    url = file_url(tmp_path / "runs" / "history.sqlite")
    begun = time.time() - 3 * 3600
    with closing(ScheduleStore.open(url)) as schedule_store:
        schedule_store.remove("nightly")
        schedule_store.add(Schedule("nightly", "nulls.yaml", "*/10 * * * *", created_at=begun))
        line = run_command("schedule", "list").err
        found = re.fullmatch(
            r"robogauntlet: no process serves the schedules: (1[78]) runs were due since (.*) UTC" + remedy, line
        )
        assert found, line
        assert found[2] == when(600 * (begun // 600 + 1))
        with exclusive_server(schedule_store.database, tmp_path / "runs"):
            assert run_command("schedule", "list").err == ""
        schedule_store.trigger_now(schedule_store.find("nightly"), time.time(), lambda *_: "run")
        assert len(schedule_store.unserved(time.time())) == 0


def test_github_gets_the_workflow_of_the_example_at_its_time_with_its_arguments(run_command, suite):
    import yaml

    example = (ROOT / "examples" / "github-nightly.yml").read_text()
    workflow = yaml.safe_load(printed(run_command, "github", cron="@daily").out)
    expected = yaml.safe_load(example)
    expected["name"] = "nightly"
    expected[True]["schedule"] = [{"cron": "0 0 * * *"}]
    run = next(step for step in expected["jobs"]["robogauntlet"]["steps"] if step.get("name") == "play and compare")
    run["with"] |= {"suite": "nulls.yaml", "arguments": "--no-media"}
    assert workflow == expected


def test_github_accepts_utc_only(run_command, suite):
    assert "GitHub runs schedules in UTC" in printed(run_command, "github", timezone="Europe/Berlin").refusal


def test_times_before_a_schedule_was_added_are_not_due(tmp_path):
    schedule_store = ScheduleStore.open(file_url(tmp_path / "history.sqlite"))
    schedule_store.add(Schedule("n", "smoke", "* * * * *", created_at=time.time()))
    assert schedule_store.record_due(time.time(), lambda schedule, due: "x") == 0
    schedule_store.close()
