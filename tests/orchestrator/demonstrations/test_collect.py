"""A whole collection: complete, continued, interrupted, and the same with any workers."""

import io
import json
import os
import shutil
import signal
import subprocess
import time

import pytest
from rich.console import Console

from robogauntlet.orchestrator.cli.common import EXIT_INTERRUPTED
from robogauntlet.orchestrator.demonstrations import collect as demonstrate
from robogauntlet.orchestrator.demonstrations.collect import (
    CollectionRequest,
    CollectionResult,
    DemonstrateError,
    collect,
    dataset_name,
    recording,
    resolve,
)
from robogauntlet.orchestrator.demonstrations.progress import DemonstrationProgress
from robogauntlet.policies.oracles import digest_of_task
from robogauntlet.policies.training.dataset import Demonstrations
from robogauntlet.policies.training.dataset_writer import DatasetWriter
from robogauntlet.policies.training.lerobot_format import DatasetError, encode_episode
from robogauntlet.results.run_document import RunStatus
from robogauntlet.suites.episode import FIRST_TRAINING_SEED, RenderProfile, View
from tests import ROOT
from tests.full_disk import no_space
from tests.policies.training import synthetic
from tests.processes import GAUNTLET, run_gauntlet

SMALL = View(image_size=16)


class Quiet:
    def __init__(self, then=lambda lanes: None):
        self.messages, self.show = [], then

    def begin(self, lanes):
        pass

    def log(self, message):
        self.messages.append(message)


def order(task="null/Reach", episodes=3, **changes):
    return CollectionRequest((task,), episodes, SMALL, **changes)


def opened(folder, task="null/Reach"):
    return Demonstrations(folder / dataset_name(task))


def journal(folder, task="null/Reach"):
    return json.loads((folder / dataset_name(task) / "meta/robogauntlet.json").read_text())


def test_patterns_tasks_and_suites_name_the_tasks_and_a_suite_the_view():
    tasks, view = resolve(["pybullet/*", "maniskill/PushCube-v1", "pybullet/PandaReach-v3"])
    assert len(tasks) == 4
    assert view == View(image_size=96, render_profile=RenderProfile.FAST)
    tasks, view = resolve(["demo"])
    assert len(tasks) == 9
    assert view.render_profile is RenderProfile.STANDARD


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (order("null/Raech"), "unknown task 'null/Raech'"),
        (order(episodes=0), "episodes: expected 1 to 100000, got 0"),
        (order(noise=-0.1), "noise: expected 0 to 1, got -0.1"),
        (order(noise=float("nan")), "noise: expected 0 to 1, got nan"),
        (order(first_seed=-1), "first seed: expected 0 to"),
        (order(workers=0), "workers: expected 1 to 256, got 0"),
        (order(learner="nowhere"), "learner: expected openpi://HOST:PORT or .* got 'nowhere'"),
        (order(whole=True), "whole: expected a learner whose part of the episode is to be recorded, got none"),
        (order(learner="zoo:experts"), "the learner cannot act in 'null/Reach'"),
        (CollectionRequest(("null/Reach",), 1, View(("front",))), "camera: expected third_person or wrist, got front"),
    ],
)
def test_an_invalid_request_is_refused_before_anything_is_written(tmp_path, wrong, message):
    with pytest.raises(DemonstrateError, match=message):
        collect(wrong, tmp_path / "out", Quiet())
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def collected(tmp_path_factory, ray_here):
    """The folder of three collected episodes, and the result of the collection."""
    folder = tmp_path_factory.mktemp("collected")
    return folder, collect(order(), folder, Quiet())


@pytest.fixture
def again(collected, tmp_path):
    """A copy of the folder of three collected episodes."""
    return shutil.copytree(collected[0], tmp_path / "again")


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
class TestWithRay:
    def test_three_episodes_are_collected(self, collected):
        folder, result = collected
        assert result.status is RunStatus.COMPLETE
        found = opened(folder)
        assert found.episodes == 3
        assert found.instructions == ("reach the goal",)
        assert found.content_hash == result.tasks[0].writer.content_hash
        assert [attempt["seed"] for attempt in journal(folder)["attempts"]] == [
            FIRST_TRAINING_SEED + i for i in range(3)
        ]

    def test_a_collection_says_what_exists_already_even_if_it_ends_before_the_first_update(self, again):
        written = io.StringIO()
        with DemonstrationProgress(Console(file=written)) as progress:
            collect(order(), again, progress)
        assert written.getvalue() == "continuing: 3 of 3 episodes already there\n"

    def test_the_data_do_not_depend_on_workers_or_on_stopping_between(self, tmp_path, monkeypatch):
        # So that the second worker is started for so few episodes.
        monkeypatch.setattr("robogauntlet.orchestrator.scheduling.work_queue.START_S", 0.0)
        for name, workers, counts in (("one", 1, (9,)), ("parts", 2, (4, 9))):
            for count in counts:
                collect(order(episodes=count, noise=0.7, workers=workers), tmp_path / name, Quiet())
        hashes = {opened(tmp_path / name).content_hash for name in ("one", "parts")}
        assert len(hashes) == 1
        assert opened(tmp_path / "one").episodes == 9

    def test_failed_episodes_are_counted_and_not_kept(self, tmp_path):
        collected = collect(order(noise=1.0, episodes=4), tmp_path, Quiet())
        (lane,) = collected.tasks
        statuses = [attempt["status"] for attempt in journal(tmp_path)["attempts"]]
        assert statuses.count("failure") == lane.rejected > 0
        assert opened(tmp_path).episodes == statuses.count("success") == lane.kept

    def test_errors_and_dead_workers_cost_an_episode_not_the_collection(self, tmp_path):
        seeds = FIRST_TRAINING_SEED // 7 * 7
        tasks, quiet = ("null/Raise", "null/Crash"), Quiet()
        collected = collect(CollectionRequest(tasks, 3, SMALL, first_seed=seeds), tmp_path, quiet)
        assert collected.status is RunStatus.COMPLETE
        for task in tasks:
            assert journal(tmp_path, task)["attempts"][0]["status"] == "error"
            assert opened(tmp_path, task).episodes == 3
        assert any("the worker process died" in line for line in quiet.messages)

    @pytest.mark.nightly
    def test_a_hanging_worker_is_killed(self, tmp_path, monkeypatch):
        monkeypatch.setenv("ROBOGAUNTLET_NULL_MARKER", str(tmp_path))
        monkeypatch.setattr(demonstrate, "EPISODE_TIME_LIMIT_S", 10.0)
        marked = {"env_vars": {"ROBOGAUNTLET_NULL_MARKER": str(tmp_path)}}
        monkeypatch.setattr(demonstrate.EnvironmentResolver, "ray_runtime_env", lambda environments, simulator: marked)
        quiet = Quiet()
        collect(order("null/Hang", 1, first_seed=FIRST_TRAINING_SEED // 7 * 7), tmp_path / "out", quiet)
        assert quiet.messages == ["null-0: an episode took longer than 10 s; its episodes go back into the queue"]
        assert opened(tmp_path / "out", "null/Hang").episodes == 1

    @pytest.mark.nightly
    def test_an_interruption_keeps_the_finished_episodes(self, tmp_path):
        def interrupt(lanes):
            if lanes[0].kept >= 5:
                raise KeyboardInterrupt

        collected = collect(order("null/Slow", 30, workers=1), tmp_path, Quiet(interrupt))
        assert collected.status is RunStatus.INTERRUPTED
        assert 5 <= opened(tmp_path, "null/Slow").episodes < 30
        assert collect(order("null/Slow", 30), tmp_path, Quiet()).status is RunStatus.COMPLETE
        assert opened(tmp_path, "null/Slow").episodes == 30

    def test_a_folder_begun_with_other_noise_is_refused(self, again):
        with pytest.raises(DatasetError, match=r"it was begun with noise 0.1, now 0.2"):
            collect(order(noise=0.2), again, Quiet())

    def test_oracles_of_other_simulators_are_not_part_of_a_datasets_source(self, collected):
        assert journal(collected[0])["source"]["oracle"] == digest_of_task("null/Reach")

    def test_a_full_disk_ends_the_collection_with_a_message(self, tmp_path, monkeypatch):
        monkeypatch.setattr("robogauntlet.policies.training.dataset_writer.pq.ParquetWriter", no_space)
        collected = collect(order(), tmp_path, Quiet())
        assert collected.status is RunStatus.STOPPED
        assert collected.warnings[0].startswith("the disk is full")

    @pytest.mark.simulator
    @pytest.mark.nightly
    def test_an_expert_acts_first_and_the_oracles_actions_are_recorded(self, tmp_path):
        task, view = "pybullet/PandaPush-v3", View(image_size=96, render_profile=RenderProfile.FAST)
        helped = collect(CollectionRequest((task,), 3, view, learner="zoo:experts"), tmp_path, Quiet())
        assert helped.status is RunStatus.COMPLETE
        assert "learner" in journal(tmp_path, task)["source"]
        shown = opened(tmp_path, task)
        steps = [a["steps"] for a in journal(tmp_path, task)["attempts"] if a["status"] == "success"]
        assert (shown.ends - shown.starts < steps).any()
        assert shown.success[shown.ends - 1].all()

    @pytest.mark.simulator
    def test_demonstrations_in_pybullet_are_collected(self, tmp_path):
        task = "pybullet/PandaReach-v3"
        collected = collect(order(task, episodes=1), tmp_path, Quiet())
        assert collected.status is RunStatus.COMPLETE
        assert "learner" not in journal(tmp_path, task)["source"]
        found = opened(tmp_path, task)
        assert (found.episodes, found.spec.fps, found.spec.image_size) == (1, 25, 16)
        assert found.success[found.ends - 1].all()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["null/Raech"], "unknown task 'null/Raech'; did you mean 'null/Reach'?"),
        (["no-such-suite"], "no-such-suite: no such file"),
        (["null/Reach", "--noise", "2"], "noise: expected 0 to 1, got 2"),
        (["null/Reach", "--camera", "front"], "camera: expected third_person or wrist, got front"),
    ],
)
def test_bad_input_is_one_line_with_exit_code_2(run_command, arguments, expected):
    assert run_command("new", "demonstrations", *arguments, "--out", "out").refusal.startswith(expected)


@pytest.mark.nightly
@pytest.mark.ray
def test_ctrl_c_ends_the_command_soon_and_the_same_command_continues(tmp_path):
    command = ["new", "demonstrations", "null/Slow", "--episodes", "400", "--out", "out", "--image-size", "16"]
    options = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": str(ROOT / "src")}, "start_new_session": True}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([*GAUNTLET, *command], **options, **pipes)
    deadline = time.monotonic() + 600
    information = tmp_path / "out" / dataset_name("null/Slow") / "meta/info.json"
    while time.monotonic() < deadline and not information.exists():
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == EXIT_INTERRUPTED, output
    assert errors.strip() == "robogauntlet: interrupted; give the same command to continue"
    there = opened(tmp_path / "out", "null/Slow").episodes
    assert there > 0
    command[command.index("400")] = str(there + 2)
    done = run_gauntlet(*command, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"continuing: {there} of {there + 2} episodes already there" in done.stdout


def test_ctrl_c_while_one_dataset_is_committed_commits_the_others_too(tmp_path, monkeypatch):
    writers = [DatasetWriter(tmp_path / name, synthetic.SOURCE) for name in "ab"]
    for writer in writers:
        episode = synthetic.recording()
        writer.add(synthetic.won(episode), encode_episode(episode))
    monkeypatch.setattr(writers[0], "commit", interrupted(writers[0].commit))
    result = CollectionResult()
    with recording(result, writers):
        pass
    assert result.status is RunStatus.INTERRUPTED
    assert [DatasetWriter(tmp_path / name, synthetic.SOURCE).episodes for name in "ab"] == [1, 1]


def interrupted(commit):
    """Return a commit during which Ctrl-C is pressed."""

    def commit_interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        commit(*arguments)

    return commit_interrupted
