"""`robogauntlet plan --width` and `--detect`: how many seeds a suite needs."""

import json

import pytest

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.run_document import create_or_continue
from tests.results.synthetic import row, run_folder

SUITE = """
name: nulls
policies: [oracle, random]
tasks: [null/Reach, null/Slow]
seeds: {count: 20}
"""


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "suite.yaml"
    path.write_text(SUITE)
    return path


@pytest.fixture
def pilot(suite, tmp_path):
    """A run of the suite in which the oracle succeeds and random fails on every fifth seed; 2 s per episode."""
    plan = make_plan(suite)
    rows = [
        row(cell, seed, "failure" if cell.policy == "random" and seed % 5 == 0 else "success")
        for cell in plan.cells
        for seed in plan.suite.seeds
    ]
    return run_folder(tmp_path / "pilot", create_or_continue(plan, tmp_path / "pilot", None), rows)


def test_given_shares_are_assumed(run_command, suite):
    output = run_command("plan", suite, "--width", 5, "--rate", 80, "--detect", 10, "--discordance", 20).out
    assert "nulls: 80 episodes, 80 to play" in output
    lines = [" ".join(line.split()) for line in output.splitlines()]
    assert "rate ±5 points, 2 tasks 123 492 ±12.1 points no" in lines
    assert "rate ±5 points, one task 245 980 ±16.8 points no" in lines
    assert "difference of 10 points, 2 tasks 84 336 19.5 points no" in lines  # 168 pairs
    assert "assumed that 20 % of pairs disagree (given); McNemar's exact test at 0.05, power 80 %" in output


def test_nothing_given_and_nothing_stored_is_the_worst_case(run_command, suite):
    output = run_command("plan", suite, "--width", 5, "--detect", 10).out
    assert "assumed that 50 % succeed (the worst case)" in output
    assert "50.5 % of pairs disagree (as of independent outcomes at rates around 50 %)" in output


def test_a_run_says_what_to_assume_and_how_long_it_takes(run_command, suite, pilot):
    found = json.loads(run_command("plan", suite, "--out", pilot, "--width", 5, "--detect", 10, "--json").out)
    assert found["to_play"] == 0
    width, _, difference, _ = found["seeds_needed"]
    assert width["assumed"]["source"] == "random, 32 of 40 stored episodes"
    assert width["assumed"]["share"] == pytest.approx(0.774, abs=0.001)
    assert difference["assumed"]["source"] == "oracle and random, 8 of 40 stored pairs"
    assert difference["worker_s"] == pytest.approx(2.0 * difference["episodes"])
    output = run_command("plan", suite, "--out", pilot, "--detect", 10).out
    assert "worker time" in output
    given = run_command("plan", suite, "--out", pilot, "--detect", 10, "--discordance", 20).out
    assert "20 % of pairs disagree (given)" in given


def test_one_policy_has_an_interval_and_no_difference(run_command, suite, pilot, tmp_path):
    assert "Seeds per task that are needed" in run_command("plan", suite, "--policy", "random", "--width", 5).out
    refused = run_command("plan", suite, "--policy", "random", "--detect", 5).refusal
    assert refused == (
        "--detect: expected two policies or more to compare, suite 'nulls' has random; add another with --policy"
    )


def test_a_run_without_verdicts_is_refused(run_command, suite, tmp_path):
    plan, folder = make_plan(suite), tmp_path / "errors"
    rows = [row(cell, seed, "error") for cell in plan.cells for seed in plan.suite.seeds]
    run_folder(folder, create_or_continue(plan, folder, None), rows)
    ask = ("plan", suite, "--out", folder)
    refused = run_command(*ask, "--width", 5).refusal
    assert refused == f"{folder}: expected clean episodes with a verdict, it has none; give --rate"
    refused = run_command(*ask, "--detect", 5).refusal
    assert refused == f"{folder}: expected clean episodes of two policies, it has no pair; give --discordance"
    assert "given" in run_command(*ask, "--detect", 5, "--discordance", 20).out
