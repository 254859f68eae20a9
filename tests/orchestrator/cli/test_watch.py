"""`robogauntlet watch`: the checkpoints of a training are evaluated while it trains."""

import sys

import pytest

from robogauntlet.results.run_document import read_run
from robogauntlet.support.files import exclusive
from tests.orchestrator.runs.checkpoints import MODULE
from tests.orchestrator.runs.playing import rows_of

SUITE = "name: nulls\nneeds: policy\ntasks: [null/Reach]\nseeds: {count: 10}\nworkers: 1\n"
OF_A_FOLDER = """

class Saved(Checkpoint):
    def __init__(self, checkpoint):
        with open(f"{checkpoint}/rate.txt") as file:
            self.rate = float(file.read())
"""


@pytest.fixture
def training(tmp_path, monkeypatch):
    """A training with two checkpoints, the second of which is better."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "steps.py").write_text(MODULE.format(seeds=10) + OF_A_FOLDER)
    (tmp_path / "nulls.yaml").write_text(SUITE)
    for name, rate in (("checkpoint-900", "0.0"), ("checkpoint-1000", "1.0")):
        (tmp_path / "training" / name).mkdir(parents=True)
        (tmp_path / "training" / name / "rate.txt").write_text(rate)
    yield tmp_path / "training"
    sys.modules.pop("steps", None)


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_checkpoints_are_played_compared_and_the_same_line_goes_on(run_command, tmp_path, training):
    kind = ("--policy-kind", "python:steps:Saved", "--option", f"folder={tmp_path}")
    typed = ("watch", "training", "--suite", "nulls.yaml", *kind, "--settle", "0")
    done = run_command(*typed, "--until", "2", "--idle", "20")
    assert (done.code, done.err) == (0, "")
    out = tmp_path / "runs" / "nulls-training"
    begun = [line.partition(":")[0] for line in done.out.splitlines() if ": 10 episodes into " in line]
    assert begun == ["checkpoint-1000", "checkpoint-900"]
    assert "improved: checkpoint-1000 against checkpoint-900; 0 % before, 100 % now of 10 episodes, " in done.out
    best = "best: checkpoint-1000, chosen by even seeds (100 %), measured by odd seeds: 100 % [57, 100] of 5 "
    assert best in done.out
    assert "checkpoint-1000: 100 % [72, 100]" in (out / "learning-curve.html").read_text()
    played = {name: rows_of(out / name) for name in ("checkpoint-900", "checkpoint-1000")}
    assert read_run(out / "checkpoint-900").command.endswith(f"--out {out.relative_to(tmp_path)}")
    again = run_command(*typed, "--idle", "0")
    assert (again.code, again.err) == (0, "")
    assert "checkpoint-900    " in again.out
    assert {name: rows_of(out / name) for name in played} == played


def test_an_interruption_says_how_to_go_on(run_command, training, monkeypatch):
    def stop(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr("robogauntlet.orchestrator.runs.checkpoint_watch.time.sleep", stop)
    done = run_command(
        "watch", "training", "--suite", "nulls.yaml", "--option", "device=cuda", "--until", "3", "--out", "out"
    )
    assert done.code == 130
    assert done.err == (
        "robogauntlet: interrupted; continue with: robogauntlet watch training --suite nulls.yaml "
        "--option 'device=\"cuda\"' --until 3 --out out\n"
    )


@pytest.mark.parametrize(
    ("typed", "refusal"),
    [
        ("watch nowhere --suite nulls.yaml", "nowhere: expected the folder into which a training writes its"),
        ("watch training --suite nuls.yaml", "nuls.yaml: no such file"),
        ("watch training --suite nulls.yaml --out nulls.yaml", "nulls.yaml: expected a folder, this is a file"),
        ("watch training --suite nulls.yaml --out busy", "busy: another process watches a training into this folder"),
    ],
)
def test_what_cannot_be_watched_is_one_line(run_command, training, tmp_path, typed, refusal):
    (tmp_path / "busy").mkdir()
    with exclusive(tmp_path / "busy" / ".watch.lock", AssertionError()):
        assert run_command(*typed.split()).refusal.startswith(refusal)
    assert not (tmp_path / "runs").exists()


def test_a_checkpoint_of_another_kind_is_one_line(run_command, training):
    options = ("--suite", "nulls.yaml", "--policy-kind", "lerobot", "--settle", "0", "--idle", "0")
    done = run_command("watch", "training", *options)
    assert done.code == 0
    assert [line.partition(" in ")[0] for line in done.err.splitlines()] == [
        f"robogauntlet: {name}: not played: policy 'training': expected a checkpoint of LeRobot 0.4 or newer"
        for name in ("checkpoint-1000", "checkpoint-900")
    ]
