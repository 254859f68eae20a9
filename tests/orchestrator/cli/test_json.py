"""Verbs with `--json` print for programs what they show to people."""

import json

import pytest

from tests.orchestrator.cli.test_cli import suite  # noqa: F401
from tests.orchestrator.cli.test_history import runs  # noqa: F401


@pytest.fixture
def printed(run_command):
    """The exit code and the JSON that a command prints."""

    def run(*arguments):
        result = run_command(*arguments, "--json")
        return result.code, json.loads(result.out)

    return run


@pytest.mark.parametrize(
    ("what", "key", "name"),
    [
        ("simulators", "simulator", "pybullet"),
        ("tasks", "task", "robosuite/Lift"),
        ("policies", "policy", "oracle"),
        ("policies", "address", "openpi://HOST:PORT"),
        ("suites", "suite", "tabletop"),
    ],
)
def test_names_are_listed(printed, what, key, name):
    code, found = printed("list", what)
    assert code == 0
    assert found.keys() == {what}
    (row,) = [row for row in found[what] if row[key] == name]
    if what == "tasks":
        assert row.keys() == {"task", "instruction", "horizon", "simulator", "installed"}


def test_a_pattern_lists_its_tasks_alone(printed, run_command):
    _, found = printed("list", "tasks", "pybullet/Panda*")
    assert found.keys() == {"tasks"}
    assert {row["task"].partition("/")[0] for row in found["tasks"]} == {"pybullet"}
    assert "no task matches 'pybulet/*'" in run_command("list", "tasks", "pybulet/*").refusal
    assert "no task matches 'libero'; did you mean 'libero/*'?" in run_command("list", "tasks", "libero").refusal


def test_the_episodes_of_a_run_are_listed_by_their_names(printed, run_command, runs):  # noqa: F811
    _, found = printed("list", "episodes", "runs/monday")
    assert len(found["episodes"]) == 160
    chosen = ("--policy", "p", "--task", "pybullet/*", "--condition", "clean", "--status", "failure")
    _, found = printed("list", "episodes", "runs/monday", *chosen)
    assert {(one["policy"], one["task"], one["outcome"]) for one in found["episodes"]} == {
        ("p", "pybullet/B", "failure")
    }
    _, found = printed("list", "episodes", "runs/monday", *chosen, "--seed", "4")
    (one,) = found["episodes"]
    assert one.keys() == {"episode", "policy", "task", "condition", "seed", "outcome", "steps"}
    printed_rows = run_command("list", "episodes", "runs/monday", *chosen).out
    assert one["episode"] in printed_rows
    assert len(printed_rows.splitlines()) == 11


def test_a_plan_has_its_cells(printed, suite):  # noqa: F811
    _, found = printed("plan", suite, "--seeds", "3")
    assert (found["suite"], found["episodes"]) == ("nulls", found["to_play"])
    assert sum(cell["missing"] for cell in found["cells"]) == found["to_play"]
    assert found["skipped"] == {}


def test_a_validation_has_the_mistakes_of_each_file(printed, suite, tmp_path):  # noqa: F811
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(suite.read_text().replace("oracle", "oracel"))
    code, found = printed("plan", "--check", suite, wrong)
    assert code == 2
    assert [len(row["mistakes"]) for row in found] == [0, 1]
    assert found[0]["episodes"] == 120
    assert found[1]["mistakes"][0].endswith("unknown policy 'oracel'; did you mean 'oracle'?")


def test_a_history_has_runs_or_the_results_of_a_policy(printed, runs):  # noqa: F811
    _, found = printed("list", "runs")
    assert (found[0]["folder"].rpartition("/")[2], found[0]["status"]) == ("half", "interrupted")
    _, found = printed("list", "runs", "p", "--suite", "synthetic")
    assert found[0]["counts"]["successes"] > 0


@pytest.mark.parametrize("suite", [["synthetic"], []], ids=["named", "of the newest run"])
def test_a_leaderboard_has_rates_and_letters(run_command, runs, suite):  # noqa: F811
    found = json.loads(run_command("compare", "--all", *suite, "--format", "json").out)
    assert {row["policy"] for row in found} >= {"p"}
    assert all(0 <= row["rate"] <= 1 and row["letters"] for row in found)
