"""`robogauntlet compare`."""

import json
from pathlib import Path

import pytest

from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import RunStatus
from robogauntlet.suites.episode import Cell, Protocol
from tests.results.synthetic import cells, document, row, run_folder

TASKS = ("maniskill/A", "pybullet/B")


def save(folder, success, **changes):
    own = cells(("p", "q"), TASKS)
    rows = [row(cell, seed, "success" if success(cell, seed) else "failure") for cell in own for seed in range(40)]
    values = {"run_id": folder.name, "regression": {"alpha": 0.05, "margin": 0.1}}
    values["rows_hash"] = rows_hash(map(outcome_row, rows))
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
    assert "- p, maniskill/A: 75 % before, 50 % now of 40 episodes, -25.0 [" in done.out
    assert "- q: the same policy, the same actions in all of 80 episodes" in done.out


def test_the_gate_takes_the_last_complete_run_of_the_suite_before(run_command, runs):
    done = run_command("compare", "--gate", runs / "wednesday")
    assert done.code == 1
    assert done.out.startswith("REGRESSED: wednesday against tuesday\n")
    quiet = run_command("compare", "--gate", runs / "tuesday")
    assert quiet.code == 0
    assert quiet.out.startswith("no evidence of a difference: tuesday against monday\n")


def test_only_the_named_policies_are_compared(run_command, runs):
    done = run_command("compare", "--gate", runs / "wednesday", "--policy", "q")
    assert done.code == 0
    assert "\n- p" not in done.out


def test_other_suites_are_compared_only_if_allowed(run_command, runs):
    done = run_command("compare", "--gate", runs / "wednesday", runs / "other")
    assert done.code == 2
    assert "suite differs: suite 'synthetic', the baseline has 'another'" in done.out
    assert run_command("compare", "--gate", runs / "wednesday", runs / "other", "--allow", "suite").code == 0


def test_it_is_written_as_json_and_markdown(run_command, runs, tmp_path):
    for form, read in (("json", json.loads), ("markdown", str)):
        file = tmp_path / form
        done = run_command("compare", "--gate", runs / "wednesday", "--format", form, "--out", file)
        assert (done.code, done.out) == (1, "")
        assert read(file.read_text())
        printed = run_command("compare", "--gate", runs / "wednesday", "--format", form)
        assert printed.out == file.read_text()


@pytest.mark.parametrize(
    "typed",
    [
        "compare wednesday monday",
        "compare half",
        "compare wednesday:p wednesday:q",
        "compare --gate wednesday monday",
        "compare --gate wednesday other",
    ],
)
def test_a_comparison_replaces_an_earlier_one_of_any_form_and_an_empty_file(run_command, runs, monkeypatch, typed):
    monkeypatch.chdir(runs)
    Path("found").touch()
    for form in ("text", "json", "markdown", "text"):
        done = run_command(*typed.split(), "--format", form, "--out", "found")
        assert (done.err, done.out) == ("", "")
        whole = run_command(*typed.split(), "--format", form).out
        assert whole.endswith(Path("found").read_text())


def test_two_policies_of_a_run_are_compared(run_command, runs):
    done = run_command("compare", f"{runs}/wednesday:p", f"{runs}/wednesday:q")
    assert done.code == 0
    assert done.out.startswith("p against q: -25.0 [")
    assert done.out.splitlines()[1] == "- Success in 80 episodes: p 50 %, q 75 %. The difference is significant at 5 %."
    back = run_command("compare", f"{runs}/wednesday:q", f"{runs}/wednesday:p", "--margin", "0.05")
    assert back.out.startswith("q against p: +25.0 [")
    assert "It is shown that q is no worse than p by more than 5 points." in back.out


def test_policies_of_two_runs_of_any_suite_are_compared(run_command, runs):
    done = run_command("compare", f"{runs}/other:p", f"{runs}/monday:q")
    assert done.code == 0
    assert done.out.startswith("other:p against monday:q: -25.0 [")


def test_a_run_alone_compares_its_policies(run_command, runs):
    done = run_command("compare", runs / "wednesday")
    assert done.out.startswith("p against q: -25.0 [")
    assert run_command("compare", runs / "wednesday", "--policy", "q", "--policy", "p").out.startswith(
        "q against p: +25.0"
    )


def test_a_comparison_of_policies_is_written_as_json_and_markdown(run_command, runs, tmp_path):
    for form, read in (("json", json.loads), ("markdown", str), ("text", str)):
        done = run_command("compare", runs / "wednesday", "--format", form, "--out", tmp_path / form)
        assert (done.code, done.out) == (0, "")
        assert read((tmp_path / form).read_text())
        assert run_command("compare", runs / "wednesday", "--format", form).out == (tmp_path / form).read_text()


def test_a_colon_in_a_path_is_no_policy(run_command, runs):
    (runs / "monday").rename(runs / "mon:day")
    assert run_command("compare", f"{runs}/mon:day", f"{runs}/tuesday").code == 0
    assert run_command("compare", f"{runs}/mon:day:p", f"{runs}/tuesday:p").out.startswith(
        "mon:day:p against tuesday:p: "
    )
    (runs / "tuesday").rename(runs / "mon")
    refusal = run_command("compare", f"{runs}/mon:day", f"{runs}/wednesday").refusal
    assert refusal.endswith(f"it is both; write {runs}/mon:day/ for the folder, {runs}/mon/:day for the policy")
    assert run_command("compare", f"{runs}/mon:day/", f"{runs}/mon/").code == 0
    assert run_command("compare", f"{runs}/mon/:p", f"{runs}/mon/:q").out.startswith("p against q: ")


def test_policies_that_share_no_episode_are_one_line(run_command, runs):
    own = [Cell(policy, policy, TASKS[0], Protocol(horizon=200)) for policy in ("p", "q")]
    longer = run_folder(runs / "longer", document(40, own), [row(cell, seed) for cell in own for seed in range(40)])
    refusal = run_command("compare", f"{longer}:p", f"{runs}/monday:q").refusal
    assert refusal == (
        "longer:p and monday:q share no episode: horizon 200 and 100; play both on the same tasks with the same seeds "
        "and protocol"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("compare", "monday:p"), "expected two policies, RUN:A RUN:B; monday:p names one"),
        (("compare", "monday:p", "tuesday"), "RUN:A RUN:B; monday:p names one and tuesday names none"),
        (("compare", "monday:p", "tuesday:Q"), "tuesday: the run has no policy 'Q'; known: p, q"),
        (("compare", "nowhere:p", "monday:p"), "nowhere: expected a run folder, it does not exist"),
        (("compare", "monday", "--policy", "p"), "monday: expected two policies to compare, got p"),
        (("compare", "monday:p", "monday:q", "--policy", "p"), "--policy: expected with a whole run only"),
        (
            ("compare", "--gate", "monday"),
            "monday: expected a complete earlier run of suite 'synthetic' beside it, found none that counts success ",
        ),
        (("compare", "monday", "nowhere"), "nowhere: expected a run folder, it does not exist"),
        (("compare", "monday", "tuesday", "--policy", "P"), "monday: the run has no policy 'P'; known: p, q"),
        (("compare", "--gate", "tuesday", "--out", "nowhere/x"), "nowhere/x: expected a file in an existing folder"),
    ],
)
def test_bad_input_is_one_line(run_command, runs, monkeypatch, arguments, message):
    monkeypatch.chdir(runs)
    assert message in run_command(*arguments).refusal
