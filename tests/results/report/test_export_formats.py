"""Tests of results/report/export_formats.py: results that other programs read."""

import json

import pytest

from robogauntlet.results.api import open_run
from robogauntlet.results.report import export_formats
from robogauntlet.results.run_document import RunError
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, row, rows_where, run_folder

CELLS = cells(("mine",), ("maniskill/A", "pybullet/B"), (Condition(), Condition("light", 3)))


@pytest.fixture
def run(tmp_path):
    rows = [*rows_where(lambda cell, seed: seed > 0, CELLS, 4), row(CELLS[0], 4, "error")]
    return open_run(run_folder(tmp_path / "run", document(5, CELLS, rows_hash="abc"), rows))


def test_lerobot_gets_tasks_groups_and_the_whole_without_errors(run):
    info = export_formats.lerobot(run.document, export_formats.of_policy(run.episodes(), None))
    assert [task["metrics"]["successes"] for task in info["per_task"]] == [[False, True, True, True]] * 4
    assert [task["task_group"] for task in info["per_task"]][:2] == ["maniskill", "maniskill light@3"]
    assert info["per_group"]["pybullet light@3"]["pc_success"] == 75.0
    assert (info["overall"]["n_episodes"], info["overall"]["pc_success"]) == (16, 75.0)
    assert info["overall"]["eval_ep_s"] == info["overall"]["eval_s"] / 16
    assert info["robogauntlet"]["rows_hash"] == "abc"
    json.dumps(info, allow_nan=False)


def test_vla_eval_gets_episodes_and_errors_that_are_in_no_mean(run):
    result = export_formats.vla_eval(run.document, export_formats.of_policy(run.episodes(), "mine"))
    first = result["tasks"][0]
    assert (first["task"], first["mean_success"]) == ("maniskill/A", 0.75)
    assert (first["num_episodes"], first["num_errors"]) == (5, 1)
    assert first["episodes"][1] == {"episode_id": 1, "metrics": {"success": True}, "steps": 40, "elapsed_sec": 2.0}
    assert first["episodes"][4]["failure_reason"] == "WorkerDied"
    assert "num_errors" not in result["tasks"][1]
    assert (result["benchmark"], result["mean_success"]) == ("synthetic", 0.75)
    json.dumps(result, allow_nan=False)


@pytest.mark.parametrize("rule", ["held", "once"])
def test_both_programs_get_their_own_rule_of_success_whatever_the_runs_is(tmp_path, rule):
    touched = [row(CELLS[0], seed, "failure", success_once=seed < 3) for seed in range(4)]
    of_run = document(4, CELLS[:1], success=rule)
    run = open_run(run_folder(tmp_path / "touched", of_run, touched))
    rows = export_formats.of_policy(run.episodes(export_formats.COLUMNS), None)
    info, result = export_formats.lerobot(of_run, rows), export_formats.vla_eval(of_run, rows)
    assert (info["overall"]["pc_success"], result["mean_success"]) == (75.0, 0.75)
    assert info["per_task"][0]["metrics"]["successes"] == [True, True, True, False]
    assert [one["metrics"]["success"] for one in result["tasks"][0]["episodes"]] == [True, True, True, False]
    for about in (info["robogauntlet"], result["config"]):
        assert (about["success"], about["success_in_run"]) == ("once", rule)


def test_a_policy_without_an_episode_has_no_rate(run):
    rows = export_formats.of_policy(run.episodes(), None)
    nothing = rows[rows["status"] == "error"]
    assert export_formats.lerobot(run.document, nothing)["overall"]["pc_success"] is None
    assert "mean_success" not in export_formats.vla_eval(run.document, nothing)
    assert "mean_success" not in export_formats.vla_eval(run.document, nothing)["tasks"][0]


def test_of_several_policies_one_has_to_be_named(run):
    rows = run.episodes()
    rows.loc[0, "policy"] = "other"
    with pytest.raises(RunError, match="the run has other, mine; name one with --policy"):
        export_formats.of_policy(rows, None)
    with pytest.raises(RunError, match="no episode of a policy 'unknown'"):
        export_formats.of_policy(rows, "unknown")
