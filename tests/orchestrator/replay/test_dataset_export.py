"""Selected episodes of a run, replayed and written as datasets."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Delivered
from robogauntlet.adapters.null import NullSimulation
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.episodes.trajectory_recorder import TrajectoryRecorder
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.replay.dataset_export import record_episode
from robogauntlet.orchestrator.replay.episode_filter import EpisodeFilter
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.training.dataset import Demonstrations
from robogauntlet.suites.episode import Cell, Condition, Episode, Protocol, View
from robogauntlet.suites.selection import SelectionError
from tests.full_disk import no_space
from tests.results.synthetic import cells, document, row, run_folder

FAILED = ("failure",)
VIEW = View(image_size=16)
TASK = "null/Reach"
SHIFTED = (Condition(), Condition("noise", 3), Condition("noise", 5), Condition("frozen-frames", 4))


@pytest.fixture
def runner():
    made = EpisodeRunner({"random": PolicySource("random"), "oracle": PolicySource("oracle")})
    yield made
    made.close()


def planned(policy="random", condition=SHIFTED[0]):
    return Cell(policy, policies.digest(policy, {}), TASK, Protocol(60, 8, VIEW), condition)


@pytest.fixture
def played(runner):
    return [runner.play_one(planned().episode(seed)) for seed in range(6)]


SYNTHETIC = cells(("p", "q"), ("maniskill/A", "pybullet/B"), SHIFTED)
RUN = document(of=SYNTHETIC)
ROWS = [row(cell, seed, ("failure", "success", "error")[seed % 3]) for cell in SYNTHETIC for seed in range(9)]


def test_all_episodes_are_selected_or_those_of_an_outcome():
    assert len(EpisodeFilter().select(RUN, ROWS)) == len(ROWS)
    chosen = EpisodeFilter(statuses=FAILED).select(RUN, ROWS)
    assert len(chosen) == len(ROWS) / 3
    assert {one.status for one in chosen} == {"failure"}
    assert [one.task for one in chosen] == sorted(one.task for one in chosen)


def test_policies_tasks_conditions_and_statuses_are_selected_by_name_or_pattern():
    choice = EpisodeFilter(("q",), ("pybullet/*",), ("noise@*", "clean"), ("success", "failure"))
    chosen = choice.select(RUN, ROWS)
    assert {(one.policy, one.task) for one in chosen} == {("q", "pybullet/B")}
    assert {(one.axis, one.severity) for one in chosen} == {("clean", 0), ("noise", 3), ("noise", 5)}
    assert {one.status for one in chosen} == {"success", "failure"}


@settings(max_examples=25)
@given(st.integers(1, 30), st.integers(0, 15), st.randoms(use_true_random=False))
def test_a_larger_limit_adds_to_a_smaller_one_in_any_order_of_rows(limit, more, shuffle):
    rows = list(ROWS)
    shuffle.shuffle(rows)
    few = EpisodeFilter(statuses=FAILED, limit=limit).select(RUN, rows)
    many = EpisodeFilter(statuses=FAILED, limit=limit + more).select(RUN, ROWS)
    assert len(few) == 2 * min(limit, 24)
    assert {one.episode_id for one in few} <= {one.episode_id for one in many}


@pytest.mark.parametrize(
    ("choice", "line"),
    [
        (EpisodeFilter(policies=("pp",)), "the run has no policy 'pp'; did you mean 'p'?"),
        (EpisodeFilter(tasks=("maniskill/C",)), "the run has no task 'maniskill/C'; did you mean 'maniskill/A'?"),
        (EpisodeFilter(conditions=("noise@4",)), "the run has no condition 'noise@4'; did you mean 'noise@"),
    ],
)
def test_a_name_that_is_not_in_the_run_is_one_line(choice, line):
    with pytest.raises(SelectionError) as error:
        choice.select(RUN, ROWS)
    assert str(error.value).startswith(line)


@pytest.mark.parametrize("axis", ["noise", "frozen-frames", "blank-instruction", "blind"])
@settings(max_examples=20)
@given(st.lists(st.booleans(), min_size=1, max_size=12), st.integers(0, 50))
def test_a_preview_equals_the_observation_and_changes_nothing(axis, observed, seed):
    severity = 1 if axis.startswith("bl") else 4
    one = Episode("p", "digest", TASK, seed, Protocol(60, 1, View(image_size=8)), Condition(axis, severity))
    seen = []
    for previewed in (False, True):
        simulation = perturbed(catalog.open_simulation(TASK, one.protocol.view), one)
        simulation.reset(seed)
        shown = []
        for observes in observed:
            preview = simulation.preview() if previewed else None
            if observes:
                shown.append(simulation.observe())
                if preview is not None:
                    assert all(np.array_equal(preview.images[c], shown[-1].images[c]) for c in preview.images)
                    assert preview.instruction == shown[-1].instruction
            simulation.step(np.array([0.01, 0, 0, 0, 0, 0, 0]))
        seen.append((shown, simulation.delivered()))
    (plain, delivered), (observed_again, after) = seen
    assert delivered == after
    assert all(
        np.array_equal(a.images[c], b.images[c]) for a, b in zip(plain, observed_again, strict=True) for c in a.images
    )


def test_a_record_holds_the_state_before_each_step_and_the_commanded_action():
    simulation = catalog.open_simulation(TASK, VIEW)
    recorder = TrajectoryRecorder(simulation)
    one = Episode("p", "digest", TASK, 3, Protocol(60, 8, VIEW), Condition("action-noise", 3))
    outer = perturbed(recorder, one)
    outer.reset(3)
    recorder.watch(outer, 0)
    commanded, places = np.array([0.02, 0, 0, 0, 0, 0, 0]), []
    for _ in range(4):
        places.append(simulation.observe().proprioception)
        outer.step(commanded)
    found = recorder.recording()
    assert np.array_equal(found.states, places)
    assert np.all(found.actions == commanded)
    assert not np.array_equal(np.diff(found.states[:, :3], axis=0), found.actions[:-1, :3])


def test_an_episode_is_recorded_to_its_end(played, runner):
    failed = next(one for one in played if one.status == "failure")
    found = record_episode(failed, runner)
    assert len(found) == failed.steps
    assert not found.success[-5:].all()
    assert found.about["episode_id"] == failed.episode_id


def test_an_episode_of_a_variant_that_measures_itself_is_recorded(runner, monkeypatch):
    monkeypatch.setattr(NullSimulation, "delivered", lambda self: Delivered(2.5, {"x": 1.0}), raising=False)
    one = runner.play_one(planned().episode(0))
    assert one.delivered == 2.5
    assert len(record_episode(one, runner)) == one.steps


def test_an_episode_with_another_outcome_is_left_out_with_a_line(played, runner):
    changed = replace(played[0], final_state_hash="0" * 16)
    line = record_episode(changed, runner)
    assert line.startswith(f"{changed.episode_id} ({TASK}, random, clean, seed 0): the outcome differs and the")
    assert 'final_state_hash: stored "0000000000000000", now' in line


@pytest.fixture
def run(played, tmp_path):
    return run_folder(tmp_path / "runs" / "nulls", document(6, [planned()], policies=["random"]), played)


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
class TestExport:
    def test_failures_become_a_dataset_that_can_be_continued(self, run_command, run, played, runner, tmp_path):
        typed = ("export", run, "--format", "lerobot-dataset")
        first = run_command(*typed, "--limit", 2)
        assert (first.code, first.err) == (0, "")
        assert "nulls-lerobot/null__Reach: 2 episodes, 120 frames\n" in first.out
        result = run_command(*typed)
        failed = {one.episode_id: one for one in played if one.status == "failure"}
        assert f"continuing: 2 of {len(failed)} episodes are recorded already\n" in result.out
        table = pd.read_parquet(tmp_path / "nulls-lerobot/null__Reach/meta/episodes/chunk-000/file-000.parquet")
        assert sorted(table["episode_id"]) == sorted(failed)
        assert [failed[name].seed for name in table["episode_id"]] == table["seed"].tolist()
        hashes = {name: record_episode(one, runner).content_hash for name, one in failed.items()}
        assert dict(zip(table["episode_id"], table["content_hash"], strict=True)) == hashes
        assert {(one.policy, one.axis, one.status) for one in table.itertuples()} == {("random", "clean", "failure")}
        opened = Demonstrations(tmp_path / "nulls-lerobot" / "null__Reach")
        assert (opened.episodes, opened.task) == (len(failed), TASK)

    def test_a_full_disk_is_one_line_and_leaves_no_partial_file(self, run_command, run, tmp_path, monkeypatch):
        with monkeypatch.context() as patch:
            patch.setattr("robogauntlet.policies.training.dataset_writer.pq.ParquetWriter", no_space)
            result = run_command("export", run, "--format", "lerobot-dataset", "--out", "data")
        assert (result.code, result.err) == (3, "robogauntlet: the disk is full; free some space and run again\n")
        assert not list((tmp_path / "data").rglob("*.parquet"))


@pytest.mark.parametrize(
    ("typed", "line"),
    [
        (("--format", "csv", "--task", "x"), "expected --task, --condition, --status and --limit with --format"),
        (("--format", "lerobot-dataset", "--policy", "x"), "the run has no policy 'x'; known: random"),
        (("--format", "lerobot-dataset", "--status", "success"), "no episode matches the options"),
    ],
)
def test_what_cannot_be_exported_is_one_line(run_command, run, typed, line):
    assert line in run_command("export", run, *typed).refusal


def test_a_policy_that_has_changed_is_one_line(run_command, run):
    text = (run / "run.json").read_text()
    digest = json.loads(text)["plan"][0]["policy_digest"]
    (run / "run.json").write_text(text.replace(digest, "f" * 16))
    refusal = run_command("export", run, "--format", "lerobot-dataset").refusal
    assert "policy 'random' has changed since the run" in refusal


def test_the_identity_survives_the_row(played):
    assert [one.episode.id for one in played] == [one.episode_id for one in played]
