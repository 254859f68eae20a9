"""Checks run in child processes, so that crashes, hangs and leaks become results."""

import os
import subprocess
import sys

import psutil
import pytest

from robogauntlet.adapters.contract import Simulator, TaskDescription
from robogauntlet.orchestrator.kit.adapter import CHECKS
from robogauntlet.orchestrator.kit.adapter.runner import TaskChecker, checks_for, default_tasks, run_checks
from robogauntlet.orchestrator.kit.finding import Level


@pytest.fixture
def start_checker():
    checkers = []

    def start(variant, limit_s=60.0):
        checkers.append(TaskChecker(f"{variant}/Reach", limit_s))
        return checkers[-1]

    yield start
    for checker in checkers:
        checker.close()


def test_a_crash_is_a_result_and_the_next_check_runs_in_a_new_process(start_checker):
    dying = start_checker("dies")
    (crashed,) = dying.run(CHECKS["step-outcome"])
    assert "expected the process to survive; seen: the process was killed by SIGKILL" in str(crashed)
    assert dying.run(CHECKS["description"])[0].level is Level.OK


def test_after_three_crashes_the_other_checks_are_skipped(start_checker):
    dying = start_checker("dies")
    results = [dying.run(CHECKS[name])[0] for name in ("step-outcome", "seeds", "action-dx", "description")]
    assert [result.level for result in results] == [Level.FAILED] * 3 + [Level.SKIPPED]
    assert results[3].text == "not run: the task's process has crashed or hung 3 times"


def test_a_hang_is_a_result_with_its_location(start_checker):
    hanging = start_checker("hangs")
    hanging.run(CHECKS["description"])  # starts the process, which takes long on a busy machine
    hanging._limit_s = 4.0
    (hung,) = hanging.run(CHECKS["step-outcome"])
    assert "expected an answer within 4 s; seen: none; look at " in str(hung)
    assert hung.look.endswith("in step")
    assert "variants.py:" in hung.look


def test_remaining_processes_are_reported_and_ended(start_checker):
    leaking = start_checker("keepsprocesses")
    (left,) = leaking.run(CHECKS["closes"])
    assert "2 more child process(s)" in str(left)
    group = leaking._process._process.pid
    ours = [process for process in psutil.process_iter() if _words(process).endswith(f"# of {group}")]
    assert len(ours) >= 3
    leaking.close()
    _, alive = psutil.wait_procs(ours, timeout=10)
    assert alive == []


def _words(process):
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def test_differences_between_processes_are_reported(start_checker):
    (other,) = start_checker("byprocess").run(CHECKS["seeds-new-process"])
    assert "seed 2 to be the same in another process; seen: others: start, end, exact_end" in str(other)


def test_a_correct_adapter_passes_in_its_own_process(start_checker):
    correct = start_checker("correct")
    for name in ("declaration", "seeds-new-process", "closes", "axis-camera-orbit"):
        assert correct.run(CHECKS[name])[0].level is Level.OK
    assert correct.run(CHECKS["axis-table"])[0].text == "toysim does not let its table be adjusted"


def test_results_are_passed_on_immediately_and_returned_by_task():
    reported = []
    results = run_checks(
        {task: [CHECKS["description"], CHECKS["observation"]] for task in ("correct/Reach", "otherwords/Reach")},
        on_finding=reported.append,
    )
    assert [(f.task, f.topic, f.level) for f in results] == [
        ("correct/Reach", "description", Level.OK),
        ("correct/Reach", "observation", Level.OK),
        ("otherwords/Reach", "description", Level.OK),
        ("otherwords/Reach", "observation", Level.FAILED),
    ]
    assert sorted(map(str, reported)) == sorted(map(str, results))


@pytest.mark.parametrize(("count", "chosen"), [(1, [0]), (3, [0, 1, 2]), (4, [0, 2, 3]), (130, [0, 64, 129])])
def test_three_evenly_spread_tasks_are_checked_by_default(count, chosen):
    cards = {f"T{i}": TaskDescription("do it", 10) for i in range(count)}
    simulator = Simulator("many", "many", cards, (), (), open=lambda task, view: None)
    assert default_tasks(simulator) == [f"many/T{i}" for i in chosen]


def test_checks_of_the_simulator_run_in_one_task_unless_all_are_requested():
    checks = CHECKS["description"], CHECKS["memory"]
    assert checks_for(["a/A", "a/B"], checks, every=False) == {"a/A": [*checks], "a/B": [checks[0]]}
    assert checks_for(["a/A", "a/B"], checks, every=True) == {"a/A": [*checks], "a/B": [*checks]}


def test_checks_of_a_tool_and_of_joints_are_for_tasks_of_theirs():
    planned = checks_for(["so101/Push", "pybullet/PandaPush-v3"], CHECKS.values(), every=True)
    names = {task: {check.name for check in found} for task, found in planned.items()}
    assert names["pybullet/PandaPush-v3"] == CHECKS.keys() - {"action-joints"}
    assert names["so101/Push"] == CHECKS.keys() - {f"action-{name}" for name in ("dx", "dy", "dz", "rx", "ry", "rz")}


def test_a_check_leaves_no_descriptor_behind():
    before = psutil.Process(os.getpid()).num_fds()
    run_checks({"correct/Reach": [CHECKS["description"]]})
    assert psutil.Process(os.getpid()).num_fds() == before


def test_the_checks_of_a_task_share_a_process_under_pytest(tmp_path):
    (tmp_path / "test_null.py").write_text(
        "from robogauntlet.orchestrator.kit import conformance_tests\n"
        "test_null = conformance_tests('null', tasks=['Reach', 'Slow'])\n"
        "def test_z(robogauntlet_checker):\n"
        "    checkers = [robogauntlet_checker(task) for task in ('null/Slow', 'null/Slow')]\n"
        "    assert checkers[0] is checkers[1]\n"
    )
    chosen = ["-k", "declaration or specs or goal or test_z", "-p", "no:cacheprovider", "--setup-show"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "test_null.py", *chosen], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout
    assert done.stdout.count("SETUP    S robogauntlet_checker") == 1
