"""The command line: exit codes, one clear line per mistake, and signals."""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import time

import pandas as pd
import pytest

from robogauntlet.orchestrator.cli.common import EXIT_BAD_INPUT, EXIT_INTERRUPTED
from robogauntlet.orchestrator.runs.plan import make_plan
from tests import ROOT
from tests.jobs import mostly_nightly
from tests.processes import GAUNTLET, run_gauntlet

SUITE = """
name: nulls
policies: [oracle, random]
tasks: [null/Slow]
seeds: {count: 60}
workers: 1
"""


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "suite.yaml"
    path.write_text(SUITE)
    return path


def test_help_names_every_verb(run_command):
    result = run_command("--help")
    assert result.code == 0
    for verb in ("run", "plan", "plan", "list", "check", "report", "replay", "replay", "new"):
        assert f" {verb} " in result.out


def test_list_names_simulators_tasks_policies_and_suites(run_command):
    output = "".join(run_command("list", what).out for what in ("simulators", "tasks", "policies", "suites"))
    for name in ("maniskill/PushCube-v1", "pybullet/PandaReach-v3", "robosuite/Lift", "oracle", "tabletop"):
        assert name in output
    assert "null/" not in output


def test_a_simulator_with_many_tasks_is_listed_in_one_line_unless_they_are_asked_for(run_command, monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.cli.list.names.MOST_LINES", 2)
    assert "robosuite/Lift" not in run_command("list", "tasks").out
    assert "robosuite/*" in run_command("list", "tasks").out
    assert "robosuite/Lift" in run_command("list", "tasks", "robosuite/*").out


def test_validate_finds_every_mistake_in_every_file(run_command, tmp_path, suite):
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(SUITE.replace("null/Slow", "null/Slo").replace("oracle", "oracel"))
    result = run_command("plan", "--check", suite, wrong)
    assert result.code == EXIT_BAD_INPUT
    assert f"{suite}: valid, 120 episodes" in result.out
    assert result.err.splitlines() == [
        f"robogauntlet: {wrong}:3: unknown policy 'oracel'; did you mean 'oracle'?",
        f"robogauntlet: {wrong}:4: unknown task 'null/Slo'; did you mean 'null/Slow'?",
    ]


def test_seeds_of_training_are_played_with_a_warning(run_command, suite):
    suite.write_text(suite.read_text().replace("{count: 60}", "{start: 999998, count: 4}"))
    said = "seeds 999998 to 1000001: those from 1000000 on are for training and development"
    assert said in run_command("plan", "--check", suite).out
    assert make_plan(suite).warnings[0].startswith(said)
    suite.write_text(suite.read_text().replace("count: 4", "count: 2"))
    assert make_plan(suite).warnings == ()


def test_quiet_prints_nothing_but_problems_and_verbose_the_traceback_too(run_command, suite):
    assert run_command("-q", "plan", "--check", suite).out == ""
    assert run_command("plan", "--check", suite).out != ""
    assert run_command("-q", "plan", "--check", "nowhere.yaml").refusal == "nowhere.yaml: no such file"
    failed = run_gauntlet("-v", "report", "nowhere").stderr.splitlines()
    assert failed[0] == "Traceback (most recent call last):"
    assert failed[-1] == "robogauntlet: nowhere: expected a run folder, it does not exist"
    assert run_command("report", "nowhere").refusal == "nowhere: expected a run folder, it does not exist"


def test_plan_counts_without_starting_anything(run_command, tmp_path, suite):
    result = run_command("plan", suite)
    assert result.code == 0
    assert "nulls: 120 episodes, 120 to play" in result.out
    assert {path.name for path in tmp_path.iterdir()} == {"suite.yaml"}


def test_axes_are_listed_and_shown_by_name(run_command):
    listed = run_command("list", "axes").out
    assert "noise" in listed
    assert "dB PSNR" in listed
    shown = run_command("list", "axes", "noise").out
    assert "noise: Independent Gaussian noise" in shown
    assert "18.4" in shown


def test_a_part_of_a_suite_is_planned(run_command, suite):
    part = ("--policy", "orac*", "--task", "null/Slow", "--seeds", "3")
    assert "nulls: 3 episodes, 3 to play" in run_command("plan", suite, *part).out
    wrong = run_command("plan", suite, "--policy", "orcale")
    assert "expected one of" not in wrong.out
    assert "the suite has no policy 'orcale'" in wrong.refusal


def test_a_rule_on_the_command_line_is_that_of_the_suite(run_command, suite, tmp_path):
    def planned(*arguments):
        return json.loads(run_command("plan", *arguments, "--json").out)["hash"]

    stated = {rule: tmp_path / f"{rule}.yaml" for rule in ("held", "once")}
    for rule, path in stated.items():
        path.write_text(suite.read_text() + f"success: {rule}\n")
    hashes = {rule: planned(path) for rule, path in stated.items()}
    assert hashes["held"] == planned(suite) != hashes["once"]
    assert planned(suite, "--success", "once") == planned(stated["held"], "--success", "once") == hashes["once"]
    assert planned(stated["once"], "--success", "held") == hashes["held"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("run", "no-such-suite"), "no-such-suite: no such file"),
        (("run", "dmeo"), "dmeo: no such file, and no shipped suite of that name; did you mean 'demo'?"),
        (("run", "nul/Reach", "--policy", "zero"), "unknown simulator 'nul'"),
        (
            ("run", "maniskil/PushCube-v1", "--policy", "zero"),
            "unknown simulator 'maniskil' in 'maniskil/PushCube-v1'; did you mean",
        ),
        (("run", "."), ".: expected a suite file, this is a directory"),
        (("run", "SUITE", "--require", "robosuite"), "robosuite: the suite does not use this simulator"),
        (("run", "SUITE", "--store", "nonsense"), "not a store URL: nonsense; expected sqlite:///FILE or postgresql"),
        (
            ("run", "SUITE", "--store", "mysql://host/db"),
            "mysql://host/db: expected an sqlite or postgresql URL, got mysql",
        ),
        (("list", "axes", "nois"), "unknown axis 'nois'; did you mean 'noise'?"),
        (("report", "no-such-folder"), "no-such-folder: expected a run folder, it does not exist"),
        (("report", "."), ".: expected a run folder, it has no run.json"),
        (("report",), "no run under runs/; name one"),
        (("replay", "0123", "--run", "no-such-folder"), "no-such-folder: expected a run folder, it does not exist"),
    ],
)
def test_bad_input_is_one_line_with_exit_code_2_and_nothing_is_written(
    run_command, tmp_path, suite, arguments, expected
):
    before = sorted(tmp_path.rglob("*"))
    refusal = run_command(*(suite if argument == "SUITE" else argument for argument in arguments)).refusal
    assert refusal.startswith(expected)
    left = [path for path in tmp_path.rglob("*") if path not in before and path.is_file() and path.name != ".lock"]
    assert left == []


def test_a_misspelt_suite_file_gets_a_suggestion(run_command, tmp_path):
    (tmp_path / "demo.yaml").write_text(SUITE)
    assert run_command("plan", "--check", "demmo.yaml").refusal == "demmo.yaml: no such file; did you mean demo.yaml?"


@pytest.fixture(scope="module")
def small_run(tmp_path_factory):
    """A suite file, the folder of its run with media, and what `robogauntlet run` printed."""
    folder = tmp_path_factory.mktemp("small")
    (suite := folder / "suite.yaml").write_text(SUITE.replace("Slow", "Reach").replace("60", "5"))
    done = run_gauntlet("run", suite, "--out", folder / "run")
    assert done.returncode == 0, done.stderr
    return suite, folder / "run", done.stdout


def episode_of_oracle(folder, seed):
    rows = pd.read_parquet(folder / "episodes.parquet")
    return rows[(rows.policy == "oracle") & (rows.seed == seed)].episode_id.item()


@pytest.mark.ray
def test_a_run_prints_its_numbers_and_where_its_report_is(small_run):
    _, folder, printed = small_run
    assert "10 of 10 episodes" in printed
    assert f"report: {folder / 'report.html'}" in printed
    assert json.loads((folder / "summary.json").read_text())["total"]["successes"] == 5


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_an_episode_is_replayed_by_the_beginning_of_its_id_and_recorded(run_command, small_run):
    _, folder, _ = small_run
    wanted = episode_of_oracle(folder, 3)
    assert "the same as stored" in run_command("replay", wanted[:10], "--run", folder).out
    assert (folder / "media/videos" / f"{wanted}.mp4").stat().st_size > 500
    named = ("--policy", "oracle", "--task", "null/Reach", "--seed", "3")
    assert "null/Reach, oracle, seed 3: success after " in run_command("replay", *named, "--run", folder).out
    assert run_command("replay", "ffffffffffff", "--run", folder).code == EXIT_BAD_INPUT


@pytest.mark.ray
def test_the_report_of_a_run_is_written_again(run_command, small_run):
    _, folder, _ = small_run
    (folder / "report.html").unlink()
    assert run_command("report", folder).code == 0
    assert (folder / "report.html").exists()


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_media_that_are_missing_are_counted_and_recorded_on_request(run_command, small_run):
    suite, folder, _ = small_run
    assert "10 episodes, 0 to play" in run_command("plan", suite, "--out", folder).out
    shutil.rmtree(folder / "media")
    slow = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(slow | {"media_s": 1000.0}))
    command = f"robogauntlet resume {folder}"
    printed = run_command("run", suite, "--out", folder).out
    assert f"not recorded: 2 videos and snapshots; to record all: {command} --media" in printed
    printed = run_command("resume", folder, "--media").out
    assert printed.index("10 of 10 episodes") < printed.index("recorded 2 videos and snapshots in")
    assert "left out" not in printed
    assert len(list((folder / "media/videos").iterdir())) == 2
    assert run_command("run", suite, "--out", folder, "-q").out == ""


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_a_replay_that_differs_names_the_differing_fields(run_command, small_run, tmp_path):
    folder = shutil.copytree(small_run[1], tmp_path / "changed")
    wanted = episode_of_oracle(folder, 1)
    with sqlite3.connect(folder / "episodes.sqlite") as database:
        database.execute("update episodes set steps = 999 where episode_id = ?", (wanted,))
    done = run_command("replay", wanted, "--run", folder, "--suite", small_run[0])
    assert done.code == 1
    assert "robogauntlet: steps: stored 999, now" in done.err


def start(suite, folder, *part):
    command = [*GAUNTLET, "run", str(suite), *part, "--out", str(folder), "--no-media"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline and count(folder) < 10:
        time.sleep(0.05)
    assert count(folder) >= 10
    return process


def count(folder):
    try:
        with sqlite3.connect(f"file:{folder / 'episodes.sqlite'}?mode=ro", uri=True, timeout=5) as database:
            return database.execute("select count(*) from episodes").fetchone()[0]
    except sqlite3.Error:
        return 0


@pytest.mark.ray
@pytest.mark.parametrize(
    "number", mostly_nightly([signal.SIGINT, signal.SIGTERM], [signal.SIGINT]), ids=lambda number: number.name
)
def test_an_interrupted_run_ends_soon_with_a_report_and_says_how_to_continue(tmp_path, suite, number):
    folder = tmp_path / "run"
    process = start(suite, folder, "--task", "null/*", "--seeds", "50")
    process.send_signal(number)
    _, complaints = process.communicate(timeout=30)
    assert process.returncode == EXIT_INTERRUPTED
    assert f"interrupted; continue with: robogauntlet resume {folder}" in complaints
    assert "Traceback" not in complaints
    assert (folder / "report.html").exists()
    assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"


@pytest.mark.ray
def test_a_killed_run_loses_and_doubles_no_row_when_continued(tmp_path, suite):
    folder = tmp_path / "run"
    process = start(suite, folder, "--seeds", "15")
    process.kill()
    process.communicate(timeout=30)
    stored = count(folder)
    assert 10 <= stored < 30
    done = run_gauntlet("run", suite, "--seeds", 15, "--out", folder, "--no-media")
    assert done.returncode == 0, done.stderr
    assert f"continuing: {stored} of 30 episodes already done" in done.stdout
    assert count(folder) == 30
