"""The section on latency, and the budget that a policy is held to."""

from dataclasses import replace

import pytest

from robogauntlet.results.report.section import load_sections
from robogauntlet.results.report.write import write_report
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, row, run_folder

SEEDS, FAILS_FROM = 120, {"quick": 5, "slow": 3}
"""Seeds of the task, and the level from which on half of a policy's episodes fail."""
CONDITIONS = (Condition(), *(Condition(axis, level) for axis in ("latency", "latency-blend") for level in range(1, 5)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    plan = cells(tuple(FAILS_FROM), ("maniskill/PushCube-v1",), CONDITIONS)
    waited = {"held_steps": 10, "stale_steps": 4, "observation_age": 0.12, "chunk_share": 0.75}
    results = [
        replace(row(cell, seed, _status(cell, seed)), **(waited if cell.condition.severity else {}))
        for cell in plan
        for seed in range(SEEDS)
    ]
    return run_folder(tmp_path_factory.mktemp("runs") / "run", document(SEEDS, plan), results)


def _status(cell, seed):
    fails = cell.condition.severity >= FAILS_FROM[cell.policy] and seed % 2
    return "failure" if fails else "success"


@pytest.fixture(scope="module")
def report(folder):
    return write_report(folder)


def test_each_policy_and_mode_has_its_success_by_milliseconds(report):
    found = report.data["latency"].curves
    assert {(one.policy, one.mode) for one in found} == {(p, m) for p in FAILS_FROM for m in ("hold", "blend")}
    (slow,) = [one for one in found if (one.policy, one.mode, one.simulator) == ("slow", "hold", "maniskill")]
    assert slow.latencies_ms == (0, 50, 100, 200, 400)
    assert [one.value for one in slow.rates] == [1, 1, 1, 0.5, 0.5]
    assert (slow.kept_ms, slow.lost_ms) == (100, 200)


def test_the_sentences_say_up_to_which_latency_success_is_kept_and_from_which_it_is_lost(report):
    (section,) = [one for one in load_sections() if one.name == "latency"]
    sentences = list(section.sentences(report.data["latency"]))
    kept = "keeps its success (loses less than 5 points) up to"
    assert f"slow, robot holds: {kept} 100 ms; a loss is shown from 200 ms." in sentences
    assert f"quick, robot blends: {kept} 400 ms; no loss is shown." in sentences


def test_the_page_says_what_the_robot_did_while_answers_took_time(report):
    page = report.paths.markdown.read_text()
    assert "## Latency" in page
    assert "| quick | latency-blend@4 | 25 % | 10 % | 120 | 75 % |" in page


def test_a_run_whose_simulation_waits_has_no_such_section(tmp_path):
    plan = cells(("quick",), ("maniskill/PushCube-v1",))
    folder = run_folder(tmp_path / "run", document(2, plan), [row(plan[0], seed) for seed in range(2)])
    assert "latency" not in write_report(folder).data


@pytest.mark.parametrize(
    ("latency", "policy", "code", "words"),
    [
        (
            200,
            "quick",
            0,
            "quick, robot holds for 200 ms: keeps its success within 5 points (120 of 120 without latency",
        ),
        (200, "slow", 1, "slow, robot blends for 200 ms: is not shown to keep its success within 5 points"),
        (100, "slow", 0, "120 with it"),
    ],
)
def test_a_policy_is_held_to_a_budget_of_latency(run_command, folder, latency, policy, code, words):
    done = run_command("compare", folder, "--latency", latency, "--policy", policy)
    assert done.code == code
    assert words in done.out
    assert len(done.out.splitlines()) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--latency", 70), "--latency: expected a latency that RUN has played, it has 50, 100, 200, 400 ms; got 70"),
        (("--latency", 50, "--gate"), "expected one of --gate, --all, --accept, --latency, got --gate and --latency"),
        (("--latency", 50, "--format", "markdown"), "--format markdown: expected text or json with --latency"),
        (("--latency", 50, "--alpha", 0.1), "--alpha: expected without --latency"),
        (("--latency", 50, "--policy", "quik"), "RUN: the run has no policy 'quik'; did you mean 'quick'?"),
    ],
)
def test_a_budget_that_cannot_be_checked_is_one_line(run_command, folder, options, message):
    assert run_command("compare", folder, *options).refusal == message.replace("RUN", str(folder))
