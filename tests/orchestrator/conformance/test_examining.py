"""Checks are played in processes of their own: what crashes, hangs or leaks there is a finding, not the end."""

import os

import psutil
import pytest

from adapters.contract import Simulator, TaskCard
from orchestrator.conformance.examining import Examination, checks_of, default_tasks, examine
from orchestrator.conformance.findings import Outcome
from orchestrator.conformance.registry import CHECKS


@pytest.fixture
def examination():
    begun = []

    def begin(liar, limit_s=60.0):
        begun.append(Examination(f"{liar}/Reach", limit_s))
        return begun[-1]

    yield begin
    for one in begun:
        one.close()


def test_a_crash_is_a_finding_and_the_next_check_is_played_in_a_new_process(examination):
    dying = examination("dies")
    (crashed,) = dying.play(CHECKS["step-outcome"])
    assert "expected the process to live; seen: the process was killed by SIGKILL" in str(crashed)
    assert dying.play(CHECKS["card"])[0].outcome is Outcome.PASSED


def test_after_three_crashes_the_other_checks_are_skipped(examination):
    dying = examination("dies")
    found = [dying.play(CHECKS[name])[0] for name in ("step-outcome", "seeds", "action-dx", "card")]
    assert [finding.outcome for finding in found] == [Outcome.FAILED] * 3 + [Outcome.SKIPPED]
    assert found[3].seen == "not played: the task's process has crashed or hung 3 times"


def test_a_hang_is_a_finding_that_says_where(examination):
    (hung,) = examination("hangs", limit_s=4.0).play(CHECKS["step-outcome"])
    assert "expected an answer within 4 s; seen: none; look at " in str(hung)
    assert hung.look.endswith("in step")
    assert "liars.py:" in hung.look


def test_processes_that_are_left_are_found_and_ended(examination):
    leaking = examination("keepsprocesses")
    (left,) = leaking.play(CHECKS["closes"])
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


def test_what_differs_from_process_to_process_is_found(examination):
    (other,) = examination("byprocess").play(CHECKS["seeds-elsewhere"])
    assert "seed 2 to be the same in another process; seen: others: start, end, exact_end" in str(other)


def test_the_honest_toy_passes_in_a_process_of_its_own(examination):
    honest = examination("honest")
    for name in ("declaration", "seeds-elsewhere", "closes", "axis-camera-orbit"):
        assert honest.play(CHECKS[name])[0].outcome is Outcome.PASSED
    assert honest.play(CHECKS["axis-table"])[0].seen == "toysim does not let its stage be adjusted"


def test_findings_are_told_as_they_come_and_returned_by_task():
    told = []
    findings = examine(
        {task: [CHECKS["card"], CHECKS["observation"]] for task in ("honest/Reach", "otherwords/Reach")},
        told=told.append,
    )
    assert [(f.task, f.check, f.outcome) for f in findings] == [
        ("honest/Reach", "card", Outcome.PASSED),
        ("honest/Reach", "observation", Outcome.PASSED),
        ("otherwords/Reach", "card", Outcome.PASSED),
        ("otherwords/Reach", "observation", Outcome.FAILED),
    ]
    assert sorted(map(str, told)) == sorted(map(str, findings))


@pytest.mark.parametrize(("count", "chosen"), [(1, [0]), (3, [0, 1, 2]), (4, [0, 2, 3]), (130, [0, 64, 129])])
def test_of_many_tasks_three_are_checked_evenly_spread(count, chosen):
    cards = {f"T{i}": TaskCard("do it", 10) for i in range(count)}
    simulator = Simulator("many", "many", cards, (), (), open=lambda task, view: None)
    assert default_tasks(simulator) == [f"many/T{i}" for i in chosen]


def test_what_tells_of_the_simulator_is_checked_in_one_task_unless_all_is_asked_for():
    checks = CHECKS["card"], CHECKS["memory"]
    assert checks_of(["a/A", "a/B"], checks, every=False) == {"a/A": [*checks], "a/B": [checks[0]]}
    assert checks_of(["a/A", "a/B"], checks, every=True) == {"a/A": [*checks], "a/B": [*checks]}


def test_a_check_leaves_no_descriptor_behind():
    before = psutil.Process(os.getpid()).num_fds()
    examine({"honest/Reach": [CHECKS["card"]]})
    assert psutil.Process(os.getpid()).num_fds() == before
