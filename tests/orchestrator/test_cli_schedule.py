"""`gauntlet schedule` as a person types it."""

import re
import subprocess
import time
from pathlib import Path

import pytest

from orchestrator.calendar.book import Book
from orchestrator.calendar.schedule import Schedule
from orchestrator.calendar.serving import served_alone
from results.database import file_url

SUITE = "name: nulls\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 5}\n"


@pytest.fixture
def suite(tmp_path):
    (tmp_path / "nulls.yaml").write_text(SUITE)


def test_a_schedule_is_added_listed_and_removed(gauntlet, suite):
    added = gauntlet("schedule", "add", "nightly", "nulls.yaml", "--cron", "0 2 * * *", "--timezone", "Europe/Berlin")
    assert re.fullmatch(r"nightly: 5 episodes of nulls, next at 20\d\d-\d\d-\d\d 0[01]:00 UTC\n", added.out)
    assert "0 2 * * * Europe/Berlin" in gauntlet("schedule", "list").out
    assert gauntlet("schedule", "remove", "nightly").out == "nightly: removed, its runs stay\n"
    assert "no schedule yet" in gauntlet("schedule", "list").out


@pytest.mark.ray
def test_run_now_plays_judges_and_leaves_its_mark_in_the_history(gauntlet, suite):
    gauntlet("schedule", "add", "nightly", "nulls.yaml", "--cron", "@daily", "--no-media")
    said = gauntlet("schedule", "run-now", "nightly")
    assert said.code == 0, said.err
    assert "nightly: done, 100 % of 5 episodes; the first of its suite" in said.out
    assert "done: 100 % of 5 episodes" in gauntlet("schedule", "list").out
    assert "nulls" in gauntlet("history").out


def test_while_another_process_serves_run_now_leaves_it_to_that(gauntlet, suite, tmp_path):
    gauntlet("schedule", "add", "nightly", "nulls.yaml", "--cron", "@daily")
    book = Book.open(file_url(tmp_path / "runs" / "history.sqlite"))
    with served_alone(book.database, tmp_path / "runs"):
        said = gauntlet("schedule", "run-now", "nightly")
        assert "the process that serves the calendar begins it" in said.out
        assert [firing.by_hand for firing in book.firings()] == [True]
        other = gauntlet("schedule", "serve")
        assert (other.code, "another process serves the calendar" in other.err) == (2, True)
    book.close()


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("add", "n", "nulls.yaml", "--cron", "0 2 * *"), "expected five fields"),
        (("add", "n", "nulls.yaml", "--cron", "0 25 * * *"), "hour '25': expected 0 to 23"),
        (("add", "n", "nulls.yaml", "--cron", "@daily", "--timezone", "Berlin"), "time zone 'Berlin': expected one"),
        (("add", "n", "nosuite", "--cron", "@daily"), "nosuite"),
        (("add", "n", "missing.yaml", "--cron", "@daily"), "missing.yaml"),
        (("add", "n", "nulls.yaml", "--cron", "@daily", "--policy", "orcle"), "orcle"),
        (("add", "a/b", "nulls.yaml", "--cron", "@daily"), "name 'a/b': expected letters"),
        (("remove", "nothing"), "no schedule 'nothing'"),
        (("run-now", "nothing"), "no schedule 'nothing'"),
        (("test-message",), "nobody is told: set GAUNTLET_WEBHOOK_URL"),
    ],
)
def test_what_cannot_be_is_one_line(gauntlet, suite, monkeypatch, typed, words):
    for name in ("GAUNTLET_WEBHOOK_URL", "GAUNTLET_SMTP_HOST"):
        monkeypatch.delenv(name, raising=False)
    said = gauntlet("schedule", *typed)
    assert said.code == 2
    assert words in said.err
    assert said.err.count("\n") == 1
    assert "no schedule yet" in gauntlet("schedule", "list").out


def test_a_name_is_taken_once(gauntlet, suite):
    gauntlet("schedule", "add", "nightly", "nulls.yaml", "--cron", "@daily")
    again = gauntlet("schedule", "add", "nightly", "nulls.yaml", "--cron", "@hourly")
    assert (again.code, "there is a schedule 'nightly' already" in again.err) == (2, True)


def printed(gauntlet, target, cron="15 2 * * 1-5", **options):
    more = [part for name, value in options.items() for part in (f"--{name}", value)]
    gauntlet("schedule", "add", "nightly", "nulls.yaml", "--cron", cron, "--no-media", *more)
    return gauntlet("schedule", "list", "--print", target)


def test_cron_gets_a_line_whose_command_is_a_shell_command(gauntlet, suite, tmp_path):
    text = printed(gauntlet, "cron").out
    note, zone, line = text.splitlines()
    assert note.startswith("# ")
    assert zone == "CRON_TZ=UTC"
    assert line.startswith("15 2 * * 1-5 cd ")
    command = line.partition("1-5 ")[2].replace(r"\%", "%")
    assert subprocess.run(["sh", "-n", "-c", command], check=False).returncode == 0
    assert "--no-media" in command
    assert "gate" in command


def test_systemd_gets_a_service_and_a_timer(gauntlet, suite):
    text = printed(gauntlet, "systemd", timezone="Europe/Berlin").out
    assert "OnCalendar=Mon,Tue,Wed,Thu,Fri *-*-* 2:15:00 Europe/Berlin\n" in text
    assert "Persistent=true" in text
    assert "%%Y%%m%%d" in text


def test_github_gets_the_workflow_of_the_example_at_its_time_with_its_arguments(gauntlet, suite):
    import yaml

    example = (Path(__file__).parents[2] / "examples" / "github-nightly.yml").read_text()
    workflow = yaml.safe_load(printed(gauntlet, "github", cron="@daily").out)
    expected = yaml.safe_load(example)
    expected["name"], expected["env"]["SUITE"] = "nightly", "nulls.yaml"
    expected[True]["schedule"] = [{"cron": "0 0 * * *"}]
    play = next(step for step in expected["jobs"]["gauntlet"]["steps"] if step.get("name") == "play")
    play["run"] = 'gauntlet run "$SUITE" --no-media --out runs/now'
    assert workflow == expected


def test_github_knows_no_time_zones(gauntlet, suite):
    said = printed(gauntlet, "github", timezone="Europe/Berlin")
    assert (said.code, "GitHub runs schedules in UTC" in said.err) == (2, True)


def test_what_was_due_before_it_was_added_is_not_due(tmp_path):
    book = Book.open(file_url(tmp_path / "history.sqlite"))
    book.add(Schedule("n", "smoke", "* * * * *", created_at=time.time()))
    assert book.take_note(time.time(), lambda schedule, due: "x") == 0
    book.close()
