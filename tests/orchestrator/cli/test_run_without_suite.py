"""Runs without a suite file, and runs of a suite with a policy that it lacks."""

import shlex
import sys

import pytest
import yaml

from robogauntlet.results.run_document import read_run
from tests.orchestrator.runs.playing import rows_of

ACT = "import numpy as np\n\ndef act(images, proprioception, instruction):\n    return np.full((4, 7), 0.01)\n"
OWN = ("--policy", "python:mine:act")
TASK = ("--task", "null/Reach")
SUITE = "name: s\npolicies: [oracle, random]\ntasks: [null/Reach, null/Slow]\nseeds: {count: 3}\n"
FREE = "name: s\nneeds: policy\ntasks: [null/Reach]\nseeds: {count: 3}\n"
SCRIPTED = "compare: {baseline: oracle, others: [random]}\noracle_gate: oracle\nno_skill_baselines: [random]\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(ACT)
    (tmp_path / "s.yaml").write_text(SUITE + SCRIPTED)
    (tmp_path / "free.yaml").write_text(FREE)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield tmp_path
    sys.modules.pop("mine", None)


@pytest.fixture
def own(folder):
    """The policy, wherever the workers run."""
    return (*OWN, "--option", f"folder={folder}")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((), "expected a suite, or --policy and --task; got no --policy and no --task"),
        (OWN, "expected a suite, or --policy and --task; got no --task"),
        (TASK, "expected a suite, or --policy and --task; got no --policy"),
        (("null/Rech", *OWN), "unknown task 'null/Rech'; did you mean 'null/Reach'?"),
        (("null/Reach",), "expected a suite, or --policy and --task; got no --policy"),
        ((*OWN, "--task", "null/Rech"), "unknown task 'null/Rech'; did you mean 'null/Reach'?"),
        ((*OWN, "--task", "pybullet/Foo*"), "unknown task 'pybullet/Foo*'; did you mean 'pybullet/Panda"),
        ((*OWN, "--task", "nul/*"), "unknown simulator 'nul' in 'nul/*'"),
        ((*OWN, "--task", "Reach"), "expected simulator/task, got 'Reach'"),
        ((*OWN, *TASK, "--condition", "noize@2"), "unknown condition 'noize'; did you mean 'noise'?"),
        ((*OWN, *TASK, "--condition", "noise@6"), "noise@6: expected a severity from 0.01 to 5, got 6"),
        ((*OWN, *TASK, "--condition", "noise@0"), "expected severities above 0 for 'noise'"),
        ((*OWN, *TASK, "--condition", "noise@two"), "condition 'noise@two': expected clean, AXIS or AXIS@SEVERITY"),
        (("--policy", "orcale", *TASK), "a kind of policy; got 'orcale'; did you mean 'oracle'?"),
        (("--policy", "python:mine:atc", *TASK), "mine has no 'atc'; did you mean 'act'?"),
        (("--policy", "python:none:act", *TASK), "expected a module 'none'"),
        (("--policy", "lerobot:/nowhere", *TASK), "expected a folder or an id on the hub, got '/nowhere'"),
        (
            ("--policy", "oracle", "--policy", "zero", *TASK, "--option", "folder=."),
            "policy 'oracle', 'zero' has no option 'folder'",
        ),
        (("--policy", "openpi://127.0.0.1:1", "--option", "retries=0", *TASK), "policy server ws://127.0.0.1:1: "),
        (("s.yaml", *OWN, "--condition", "noise"), "--condition: expected --policy and --task instead of a suite file"),
        (("s.yaml", "--option", "folder=."), "--option: expected --policy with a policy that the suite lacks"),
        (("s.yaml", "--policy", "orcale"), "s.yaml: the suite has no policy 'orcale'; did you mean 'oracle'?"),
        (("s.yaml", "--policy", "python:mine:atc"), "mine has no 'atc'; did you mean 'act'?"),
        (
            ("s.yaml", "--policy", "replay", *TASK),
            "policy 'replay' does not fit: it cannot act in null/Reach; it can in ",
        ),
        (("free.yaml",), "free.yaml: the suite needs a policy; add --policy with openpi://HOST:PORT or "),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(run_command, folder, arguments, line):
    before = sorted(folder.iterdir())
    refusal = run_command("run", *arguments, "--out", "run").refusal if arguments else run_command("run").refusal
    assert line in refusal
    assert [path for path in sorted(folder.iterdir()) if path.name != "__pycache__"] == before


def test_a_policy_is_played_in_a_suite_instead_of_its_own(run_command, folder):
    planned = run_command("plan", "s.yaml", *OWN, "--task", "*Slow", "--seeds", "2")
    assert "python-mine-act" in planned.out
    assert "s: 2 episodes, 2 to play" in planned.out
    beside = run_command("plan", "s.yaml", *OWN, "--policy", "oracle")
    assert "s: 12 episodes, 12 to play" in beside.out


def test_a_suite_that_needs_a_policy_is_valid_and_is_planned_with_one(run_command, folder):
    validated = run_command("plan", "--check", "free.yaml")
    assert "free.yaml: valid, 0 episodes" in validated.out
    assert "note: needs a policy, to play " in validated.out
    assert "s: 3 episodes, 3 to play" in run_command("plan", "free.yaml", *OWN).out
    assert "needs a policy" in run_command("plan", "free.yaml").refusal


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_one_line_runs_a_function_and_the_same_line_continues(run_command, folder, own):
    line = ("run", "null/Reach", *own, "--seeds", "2", "--condition", "noise@2,4", "--out", "run", "--no-media")
    first = run_command(*line)
    assert (first.code, first.err) == (0, "")
    assert "null-Reach: 6 episodes into run" in first.out
    written = yaml.safe_load((folder / "run" / "suite.yaml").read_text())
    assert written["policies"] == [
        {"name": "python-mine-act", "kind": "python", "options": {"callable": "mine:act", "folder": str(folder)}}
    ]
    assert written["conditions"] == ["clean", {"axis": "noise", "severities": [2, 4]}]
    assert {(row.axis, row.severity) for row in rows_of(folder / "run")} == {("clean", 0), ("noise", 2), ("noise", 4)}
    again = run_command(*line)
    assert "continuing: 6 of 6 episodes already done" in again.out
    resume = shlex.split(read_run(folder / "run").command)
    assert "6 of 6 episodes" in run_command(*resume[1:]).out
    other = run_command(*line[:-3], "--seeds", "3", "--out", "run")
    assert "plans other episodes than when the run was begun" in other.refusal


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_tasks_in_which_the_policy_cannot_act_are_left_out_and_the_report_says_so(run_command, folder):
    (folder / "free.yaml").write_text(FREE.replace("[null/Reach]", '[null/Reach, "libero/goal-0-*"]'))
    line = ("run", "free.yaml", "--policy", "oracle", "--out", "run", "--no-media")
    begun = run_command(*line, "--task", "null/*")
    assert "left out" not in begun.out + begun.err
    assert read_run(folder / "run").tasks_left_out == ()
    continued = run_command(*line)
    name = "libero/goal-0-open-middle-drawer-cabinet"
    assert f"s: 1 task left out, in which a policy cannot act: {name}" in continued.out
    assert read_run(folder / "run").tasks_left_out == (name,)
    assert "1 task of the suite left out" in (folder / "run" / "report.md").read_text()
    assert name in (folder / "run" / "report.html").read_text()


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_a_suite_with_another_policy_is_a_run_without_the_roles_of_its_own(run_command, folder, own):
    done = run_command("run", "s.yaml", *own, "--option", "files=[s.yaml]", *TASK, "--out", "run", "--no-media")
    assert done.code == 0, done.err
    suite = read_run(folder / "run").suite
    assert [(policy.name, policy.kind) for policy in suite.policies] == [("python-mine-act", "python")]
    assert suite.policies[0].options["files"] == ["s.yaml"]
    assert (suite.compare, suite.oracle_gate, suite.no_skill_baselines) == (None, None, ())
    resume = shlex.split(read_run(folder / "run").command)
    assert resume[1:] == ["resume", "run"]
    assert "continuing: 3 of 3 episodes already done" in run_command(*resume[1:]).out
