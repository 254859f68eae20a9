"""`robogauntlet search checkpoint`, and `robogauntlet.bisect`: they find the checkpoint that became worse."""

import json
import shlex
import shutil
import sys

import pytest

import robogauntlet
from robogauntlet.orchestrator.runs import run
from robogauntlet.orchestrator.runs.checkpoint_search import CheckpointSearch
from robogauntlet.results.run_document import RunStatus, read_run
from robogauntlet.support.errors import BadInput
from tests.errors import one_line_error
from tests.mergevla.experts import save_base
from tests.orchestrator.runs.checkpoints import write_checkpoints
from tests.orchestrator.runs.playing import rows_of

TASK = ("--task", "null/Reach")
RATES = (1.0, 1.0, 1.0, 0.0, 0.0)


@pytest.fixture
def steps(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield lambda rates=RATES: write_checkpoints(tmp_path, rates)
    sys.modules.pop("steps", None)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, ray_here, room_for_one):
    """A whole search from Python: its checkpoints, its result and its run folder."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", list(sys.path))
        patch.chdir(folder)
        patch.delenv("ROBOGAUNTLET_HISTORY", raising=False)
        steps = write_checkpoints(folder, RATES)
        good, *between, bad = steps
        options = {"folder": str(folder)}
        found = robogauntlet.bisect(good, bad, between, "null/Reach", 60, "run", options=options, quiet=True, workers=1)
    sys.modules.pop("steps", None)
    return steps, found, folder / "run"


def line(tmp_path, steps, *more):
    good, *between, bad = steps
    return (
        "search",
        "checkpoint",
        "--good",
        good,
        "--bad",
        bad,
        *between,
        *TASK,
        "--option",
        f"folder={tmp_path}",
        *more,
    )


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_the_first_worse_checkpoint_is_printed_and_the_same_line_plays_nothing_more(run_command, tmp_path, steps):
    typed = line(tmp_path, steps(), "--seeds", "60", "--out", "run")
    done = run_command(*typed)
    assert (done.code, done.err) == (0, "")
    assert "bisect-null-Reach: 300 episodes at most, into run" in done.out
    assert "is python:steps:Step4 worse? python:steps:Step4 " in done.out
    assert "first worse: python:steps:Step3, after python:steps:Step2, with 95 % confidence" in done.out
    played, document = rows_of(tmp_path / "run"), read_run(tmp_path / "run")
    assert f"{len(played)} episodes; all checkpoints on all seeds would have been 300" in done.out
    assert len(played) == document.planned < 200
    assert document.status is RunStatus.COMPLETE
    assert (tmp_path / "run" / "report.html").exists()
    again = run_command(*shlex.split(document.command)[1:], "--json")
    found = json.loads(again.out)
    assert (again.code, found["first_worse"], found["episodes"]) == (0, "python:steps:Step3", len(played))
    assert [one["is_worse"] for one in found["checkpoints"]] == [False, None, False, True, True]
    assert rows_of(tmp_path / "run") == played
    other = run_command(*typed[:-4], "--seeds", "70", "--out", "run")
    assert "plans other episodes than when the run was begun" in other.refusal


@pytest.mark.nightly
@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_a_search_that_was_interrupted_goes_on_with_its_rows(run_command, tmp_path, steps, monkeypatch, whole):
    rounds = CheckpointSearch.__call__

    def interrupted(self, cells, outcomes):
        if sum(map(len, outcomes.values())) >= 20:
            raise KeyboardInterrupt
        return rounds(self, cells, outcomes)

    typed = line(tmp_path, steps(), "--seeds", "60", "--out", "run")
    monkeypatch.setattr(CheckpointSearch, "__call__", interrupted)
    stopped = run_command(*typed)
    assert stopped.code == 130
    command = "robogauntlet search checkpoint --good python:steps:Step0 "
    assert f"robogauntlet: interrupted; continue with: {command}" in stopped.err
    before = rows_of(tmp_path / "run")
    assert len(before) == 20
    monkeypatch.setattr(CheckpointSearch, "__call__", rounds)
    done = run_command(*typed)
    assert done.code == 0
    assert "first worse: python:steps:Step3, after python:steps:Step2, with 95 % confidence" in done.out
    assert f"{whole[1].episodes} episodes; all checkpoints on all seeds would have been 300" in done.out
    after = rows_of(tmp_path / "run")
    assert all(row in after for row in before)  # as they were stored, with their times
    assert read_run(tmp_path / "run").rows_hash == read_run(whole[2]).rows_hash


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_ends_that_do_not_differ_are_one_line(run_command, tmp_path, steps):
    refusal = run_command(*line(tmp_path, steps((0.5, 0.5, 0.5)), "--seeds", "10", "--out", "run")).refusal
    assert refusal.startswith("the ends do not differ: python:steps:Step2 is not shown to be worse than ")
    assert refusal.endswith("; give other ends, or more seeds")
    assert {row.policy for row in rows_of(tmp_path / "run")} == {"python-steps-Step0", "python-steps-Step2"}


@pytest.mark.ray
@pytest.mark.nightly
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_seeds_that_do_not_decide_leave_a_range(run_command, tmp_path, steps):
    done = run_command(*line(tmp_path, steps((1.0, 0.5, 0.0)), "--seeds", "20", "--out", "run"))
    assert done.code == 3
    assert "first worse: one of python:steps:Step1, python:steps:Step2, with 95 % confidence" in done.out
    assert "the seeds do not decide which" in done.out


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_a_checkpoint_that_cannot_act_stops_the_search(run_command, tmp_path, steps):
    good, bad = steps((1.0, 0.0))
    (tmp_path / "steps.py").write_text((tmp_path / "steps.py").read_text() + "\n    def reset(self):\n        1 / 0\n")
    done = run_command(
        "search", "checkpoint", "--good", good, "--bad", bad, *TASK, "--option", f"folder={tmp_path}", "--out", "run"
    )
    assert done.code == 3
    assert "stopped: run: python:steps:Step1: 10 episodes ended in an error, none was played" in done.err


@pytest.mark.nightly
@pytest.mark.ray
def test_python_returns_the_result_and_plays_nothing_else(whole):
    steps, found, folder = whole
    assert (found.first_worse, found.candidates) == (steps[3], (steps[3],))
    assert found.episodes == len(rows_of(folder))


def test_a_copy_of_a_checkpoint_is_the_same_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(save_base(tmp_path / "base"), tmp_path / "copy")
    with one_line_error(BadInput, "policies 'base' and 'copy' are the same policy; remove one"):
        robogauntlet.bisect("base", "zero", ["copy"], "null/Reach", image_size=16)


def test_a_search_keeps_its_rule_of_success_when_it_is_continued(run_command, tmp_path, monkeypatch):
    def caught(texts, plan, *rest, **more):
        assert plan.suite.success_rule == "once"
        raise KeyboardInterrupt

    monkeypatch.setattr("robogauntlet.orchestrator.cli.search.checkpoint.play_search", caught)
    stopped = run_command("search", "checkpoint", "--good", "oracle", "--bad", "zero", *TASK, "--success", "once")
    command = "robogauntlet search checkpoint --good oracle --bad zero --task null/Reach --success once"
    assert f"continue with: {command}" in stopped.err


def test_mistakes_in_python_are_one_line_and_nothing_is_started(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "run_plan", None)
    with one_line_error(BadInput, "expected each policy once, got 'zero' twice"):
        robogauntlet.bisect("oracle", "zero", ["zero"], "null/Reach")
    with one_line_error(BadInput, "seeds: expected their number, 10,000 at most, got 20000"):
        robogauntlet.bisect("oracle", "zero", [], "null/Reach", 20_000)
    assert not list(tmp_path.iterdir())
