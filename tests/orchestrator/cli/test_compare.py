"""`robogauntlet compare` and `robogauntlet gate`."""

import json
from xml.etree import ElementTree

import pytest

from robogauntlet.results.run_document import RunStatus
from tests.results.synthetic import cells, document, row, run_folder

TASKS = ("maniskill/A", "pybullet/B")


def save(folder, success, **changes):
    own = cells(("p", "q"), TASKS)
    rows = [row(cell, seed, "success" if success(cell, seed) else "failure") for cell in own for seed in range(40)]
    values = {"run_id": folder.name, "regression": {"alpha": 0.05, "margin": 0.1}}
    return run_folder(folder, document(40, own, **{**values, **changes}), rows)


def good(cell, seed):
    return seed % 4 != 0


def bad(cell, seed):
    return good(cell, seed) and (cell.policy != "p" or seed % 4 != 1)


@pytest.fixture
def runs(tmp_path):
    """Two nights that are alike, an unfinished one, one of another suite, and one that is worse."""
    root = tmp_path / "runs"
    save(root / "monday", good, started_at=1.0)
    save(root / "tuesday", good, started_at=2.0)
    save(root / "half", bad, started_at=3.0, status=RunStatus.INTERRUPTED)
    save(root / "other", bad, started_at=4.0, name="another")
    save(root / "wednesday", bad, started_at=5.0)
    return root


def test_a_regression_is_printed_and_sets_the_exit_code(run_command, runs):
    done = run_command("compare", runs / "wednesday", runs / "monday")
    assert done.code == 1
    assert "REGRESSED: wednesday against monday\n" in done.out
    assert "- p, maniskill/A: 75 % before, 50 % now of 40 episodes, -25.0 points [" in done.out
    assert "- q: the same policy, the same actions in all of 80 episodes" in done.out


def test_the_gate_takes_the_last_complete_run_of_the_suite_before(run_command, runs):
    done = run_command("gate", runs / "wednesday")
    assert done.code == 1
    assert done.out.startswith("REGRESSED: wednesday against tuesday\n")
    quiet = run_command("gate", runs / "tuesday")
    assert quiet.code == 0
    assert quiet.out.startswith("no evidence of a difference: tuesday against monday\n")


def test_only_the_named_policies_are_compared(run_command, runs):
    done = run_command("gate", runs / "wednesday", "--policy", "q")
    assert done.code == 0
    assert "\n- p" not in done.out


def test_other_suites_are_compared_only_if_allowed(run_command, runs):
    done = run_command("gate", runs / "wednesday", "--baseline", runs / "other")
    assert done.code == 2
    assert "suite differs: suite 'synthetic', the baseline has 'another'" in done.out
    assert run_command("gate", runs / "wednesday", "--baseline", runs / "other", "--allow", "suite").code == 0


def test_it_is_written_as_json_markdown_and_junit(run_command, runs, tmp_path):
    for form, read in (("json", json.loads), ("junit", ElementTree.fromstring), ("markdown", str)):
        file = tmp_path / form
        done = run_command("gate", runs / "wednesday", "--format", form, "--out", file)
        assert (done.code, done.out) == (1, "")
        assert read(file.read_text())
        printed = run_command("gate", runs / "wednesday", "--format", form)
        assert printed.out == file.read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("gate", "monday"), "monday: expected a complete earlier run of suite 'synthetic' beside it, found none; "),
        (("compare", "monday", "nowhere"), "nowhere: expected a run folder, there is nothing"),
        (("compare", "monday", "tuesday", "--policy", "P"), "monday: the run has no policy 'P'; known: p, q"),
        (("gate", "tuesday", "--out", "nowhere/x"), "nowhere/x: cannot be written: No such file or directory"),
    ],
)
def test_bad_input_is_one_line(run_command, runs, monkeypatch, arguments, message):
    monkeypatch.chdir(runs)
    assert message in run_command(*arguments).refusal
