"""The checkpoints of a training are played one by one; here without playing: their runs are written as they are."""

import io
import os
import shutil
from types import SimpleNamespace

import pytest
from rich.console import Console

from robogauntlet.orchestrator.runs import checkpoint_watch
from robogauntlet.orchestrator.runs.checkpoint_folder import ReadyCheckpoints
from robogauntlet.orchestrator.runs.checkpoint_watch import CheckpointWatch, Watched, policy_of
from robogauntlet.results.analysis.comparison import Verdict
from robogauntlet.results.api import compare
from robogauntlet.results.report.comparison import in_one_line
from robogauntlet.results.run_document import RunStatus
from robogauntlet.support.errors import BadInput
from tests.orchestrator.runs.test_checkpoint_folder import write
from tests.results.synthetic import cells, document, row, run_folder, suite

SEEDS = 20
SUITE = "name: nulls\nneeds: policy\ntasks: [null/Reach]\nseeds: {count: 20}\n"
FACTORY = "python:steps:Step"


PLANNED = cells(("training",), ("null/Reach",))


def write_run(folder, rate, status=RunStatus.COMPLETE, of=PLANNED, **changes):
    """A run of a checkpoint that succeeds on the first seeds."""
    rows = [row(cell, seed, "success" if seed < rate * SEEDS else "failure") for cell in of for seed in range(SEEDS)]
    named = {"suite": suite("nulls"), "suite_text": SUITE, **changes}
    return run_folder(folder, document(SEEDS, of, run_id=folder.name, status=status, **named), rows)


class Written(CheckpointWatch):
    """Writes the run of a checkpoint with a known rate or status, or raises what is given instead."""

    rates: dict
    played: list

    def _run(self, one):
        self.played.append(one.name)
        outcome = self.rates.get(one.name, 0.5)
        if isinstance(outcome, BaseException):
            raise outcome
        status = outcome if isinstance(outcome, RunStatus) else RunStatus.COMPLETE
        if status is RunStatus.STOPPED:
            shutil.rmtree(one.folder)
        rate = 0.5 if isinstance(outcome, RunStatus) else outcome
        folder = write_run(self.out / one.name, rate, status, reason="no weights", started_at=4e9)
        run = checkpoint_watch.read_run(folder)
        return SimpleNamespace(document=run, warnings=["few seeds"], done=7, folder=folder)


@pytest.fixture
def training(tmp_path):
    (tmp_path / "nulls.yaml").write_text(SUITE)
    (tmp_path / "training").mkdir()
    return tmp_path / "training"


@pytest.fixture
def watch(training, monkeypatch):
    """Watches the training with these outcomes of its checkpoints; every look is a second later."""
    lines, clock = [], [0.0]
    monkeypatch.setattr(checkpoint_watch, "time", SimpleNamespace(monotonic=lambda: clock[0], sleep=lambda s: tick(s)))
    later = []

    def tick(seconds):
        clock[0] += seconds
        if later:
            later.pop(0)()

    def start(**rates):
        watched = Watched.read(training, str(training.parent / "nulls.yaml"), FACTORY, {})
        ready = ReadyCheckpoints(training, 0.0, lines.append, lambda: clock[0])
        out, console = training.parent / "out", Console(file=io.StringIO())
        watching = Written(watched, out, ready, lines.append, console, "robogauntlet watch")
        watching.rates, watching.played = {name.replace("_", "-"): rate for name, rate in rates.items()}, []
        watching.continue_runs()
        return watching

    start.lines, start.later = lines, later
    return start


def test_the_newest_is_played_first_and_what_comes_meanwhile_before_what_is_old(training, watch):
    for name in ("checkpoint-1", "checkpoint-2"):
        write(training, name)
    watching = watch()
    found = []
    for one in watching.evaluations(until=None, idle_s=5.0):
        found.append(one.name)
        if len(found) == 1:
            write(training, "checkpoint-3")
    assert found == watching.played == ["checkpoint-2", "checkpoint-3", "checkpoint-1"]
    assert [point.name for point in watching.curve.points] == ["checkpoint-1", "checkpoint-2", "checkpoint-3"]


def test_it_waits_for_checkpoints_and_ends_when_nothing_comes_for_long(training, watch):
    watching = watch()
    watch.later += [lambda: None, lambda: write(training, "checkpoint-1"), lambda: write(training, "checkpoint-2")]
    assert [one.step for one in watching.evaluations(until=None, idle_s=6.0)] == [1, 2]


def test_it_ends_at_a_number_of_checkpoints_those_of_before_included(training, watch):
    for name in ("checkpoint-1", "checkpoint-2", "checkpoint-3"):
        write(training, name)
    assert [one.step for one in watch().evaluations(until=2, idle_s=None)] == [3, 2]
    again = watch()
    assert [point.step for point in again.curve.points] == [2, 3]
    assert [one.step for one in again.evaluations(until=2, idle_s=None)] == []
    assert [one.step for one in again.evaluations(until=3, idle_s=None)] == [1]


def test_an_interruption_ends_it_and_the_run_is_continued_by_the_next(training, watch):
    write(training, "checkpoint-1")
    with pytest.raises(KeyboardInterrupt):
        next(watch(checkpoint_1=RunStatus.INTERRUPTED).evaluations(until=1, idle_s=None))
    again = watch()
    assert again.curve.points == ()
    assert [one.step for one in again.evaluations(until=1, idle_s=None)] == [1]


def test_what_cannot_be_played_is_a_line_each_and_the_others_go_on(training, watch):
    for name in ("checkpoint-1", "checkpoint-2", "checkpoint-3"):
        write(training, name)
    watching = watch(checkpoint_3=BadInput("of another kind\nand more"), checkpoint_2=RunStatus.STOPPED)
    assert [one.step for one in watching.evaluations(until=None, idle_s=20.0)] == [1]
    assert watching.played == ["checkpoint-3", "checkpoint-2", "checkpoint-1"]  # once each
    assert watch.lines == [
        "checkpoint-3: not played: of another kind",
        "checkpoint-2: few seeds",
        "checkpoint-2: deleted; stopped: no weights; 7 of 20 episodes are kept in "
        f"{training.parent / 'out' / 'checkpoint-2'}",
    ]


def test_each_checkpoint_is_compared_with_the_last_one_and_a_later_one_with_it(training, watch):
    for name in ("checkpoint-1", "checkpoint-2"):
        write(training, name)
    watching = watch(checkpoint_1=0.9, checkpoint_2=0.1, checkpoint_3=0.9)
    evaluations = watching.evaluations(until=3, idle_s=None)
    assert watching.comparisons(next(evaluations)) == []
    (found,) = watching.comparisons(next(evaluations))
    assert (found.run, found.baseline, found.verdict) == ("checkpoint-2", "checkpoint-1", Verdict.REGRESSED)
    write(training, "checkpoint-3")
    (found,) = watching.comparisons(next(evaluations))
    assert (found.run, found.baseline, found.verdict) == ("checkpoint-3", "checkpoint-2", Verdict.IMPROVED)


def test_a_comparison_is_one_line(tmp_path):
    runs = [write_run(tmp_path / f"checkpoint-{rate}", rate) for rate in (0.2, 0.9)]
    assert in_one_line(compare(*reversed(runs))).startswith(
        "improved: checkpoint-0.9 against checkpoint-0.2; 20 % before, 90 % now of 20 episodes, +70.0 ["
    )
    other = write_run(tmp_path / "other", 0.2, suite=suite("other"))
    assert in_one_line(compare(other, runs[0])) == (
        "NOT COMPARABLE: other against checkpoint-0.2; suite differs: suite 'other', the baseline has 'nulls' "
        "(compare all the same: --allow suite)"
    )


def test_the_best_is_chosen_on_even_seeds(training, watch):
    write(training, "checkpoint-1")
    watching = watch(checkpoint_1=0.55)
    list(watching.evaluations(until=1, idle_s=None))
    assert (watching.curve.best.chosen_on, watching.curve.best.measured_on) == ((6, 10), (5, 10))


def test_a_checkpoint_that_is_written_again_keeps_its_run(training, watch):
    write(training, "checkpoint-1")
    write_run(training.parent / "out" / "checkpoint-1", 0.5, started_at=2e9)
    os.utime(training / "checkpoint-1" / "config.json", (3e9, 3e9))
    watching = watch()
    assert watch.lines == [f"checkpoint-1: {checkpoint_watch.REWRITTEN}"]
    assert [point.step for point in watching.curve.points] == [1]
    with pytest.raises(BadInput, match="written again after its run began"):
        CheckpointWatch._run(watching, watching.ready.look()[0])


def test_the_run_of_a_deleted_checkpoint_stays_in_the_curve(training, watch):
    write_run(training.parent / "out" / "checkpoint-1", 0.5)
    assert [point.step for point in watch().curve.points] == [1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"suite": suite("other")}, "got one of 'training' in 'other'; choose another folder with --out"),
        ({"of": cells(("act",), ("null/Reach",))}, "got one of 'act' in 'nulls'; choose another folder with --out"),
        ({"suite_text": SUITE + "horizon: 5\n"}, "got one of another text of it; choose another folder with --out"),
    ],
    ids=["another suite", "another training", "a changed suite"],
)
def test_a_folder_with_other_runs_is_refused(training, watch, changes, message):
    write_run(training.parent / "out" / "checkpoint-1", 0.5, **changes)
    with pytest.raises(BadInput, match=message):
        watch()


@pytest.mark.parametrize(
    ("text", "kind", "options", "message"),
    [
        (SUITE.replace("20", "1"), FACTORY, {}, "expected 2 seeds or more, since even seeds choose the best .* got 1"),
        (
            SUITE.replace("needs: policy", "policies: [{name: training, kind: oracle}]"),
            None,
            {},
            "expected no policy 'training' in the suite, it has one; rename one of them",
        ),
        (SUITE, "oracle", {}, "--policy-kind oracle: expected a kind with an option checkpoint, or python:MODULE:NAME"),
        (SUITE, "lerobt", {}, "got 'lerobt'; did you mean 'lerobot'"),
        (SUITE, "lerobot", {"devise": "cuda"}, "policy 'lerobot' has no option 'devise'; did you mean 'device'"),
        (SUITE, FACTORY, {"options": 3}, "--option options: expected a mapping of arguments, got 3"),
    ],
)
def test_what_cannot_be_watched_is_refused_before_anything_starts(training, text, kind, options, message):
    (training.parent / "nulls.yaml").write_text(text)
    with pytest.raises(BadInput, match=message):
        Watched.read(training, str(training.parent / "nulls.yaml"), kind, options)


@pytest.mark.parametrize(("name", "what"), [("nowhere", "it does not exist"), ("nulls.yaml", "this is a file")])
def test_a_folder_must_be_there(training, name, what):
    with pytest.raises(BadInput, match=f"expected the folder into which a training writes its checkpoints, {what}"):
        Watched.read(training.parent / name, str(training.parent / "nulls.yaml"), FACTORY, {})


def test_the_policy_has_the_name_of_the_training_in_all_runs(training):
    (training / "checkpoints").mkdir()
    for folder in (training, training / "checkpoints"):
        assert Watched.read(folder, str(training.parent / "nulls.yaml"), None, {}).policy == "training"


def test_the_folder_of_a_checkpoint_becomes_the_policys(tmp_path):
    entry = policy_of(FACTORY, tmp_path, {"folder": "here", "options": {"speed": 2}}, "act")
    assert (entry.name, entry.kind) == ("act", "python")
    arguments = {"speed": 2, "checkpoint": str(tmp_path)}
    assert entry.options == {"callable": "steps:Step", "folder": "here", "options": arguments}
    assert policy_of("lerobot", tmp_path, {"device": "cuda"}, "act").options == {
        "checkpoint": str(tmp_path),
        "device": "cuda",
    }
    with pytest.raises(BadInput, match="a folder without a checkpoint"):
        policy_of(None, tmp_path, {}, "act")
    (tmp_path / "config.json").write_text("{}")
    assert policy_of(None, tmp_path, {}, "act").kind == "lerobot"


def test_a_checkpoint_is_played_as_it_is_named_with_its_own_copy_of_the_suite_and_errors_again(
    training, watch, monkeypatch
):
    write(training, "checkpoint-1")
    watching, calls = watch(), []
    (training.parent / "nulls.yaml").write_text("edited meanwhile")
    monkeypatch.setattr(
        checkpoint_watch, "make_plan", lambda path, **given: SimpleNamespace(path=path, episodes=20, **given)
    )
    monkeypatch.setattr(checkpoint_watch, "run_plan", lambda *given: calls.append(given))
    CheckpointWatch._run(watching, watching.ready.look()[0])
    ((plan, folder, options, _),) = calls
    assert folder == training.parent / "out" / "checkpoint-1"
    assert (plan.path, plan.text) == (folder / "suite.yaml", SUITE)
    (entry,) = plan.part.added
    assert (entry.name, entry.options["options"]) == ("training", {"checkpoint": str(training / "checkpoint-1")})
    assert (options.retry_errors, options.media, options.command) == (True, False, "robogauntlet watch")
