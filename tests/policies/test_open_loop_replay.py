"""Open-loop replay of a recorded demonstration."""

import json

import numpy as np
import pytest

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, bundle_layout
from robogauntlet.policies import open_loop_replay
from robogauntlet.policies.contract import PolicyError, Query
from robogauntlet.suites.episode import FIRST_TRAINING_SEED, Episode, Protocol, RenderProfile, View
from tests.policies.training.synthetic import recording, write
from tests.policies.zoo import WITH_EXPERTS


def episode(task, seed=0, horizon=100):
    view = View(image_size=96, render_profile=RenderProfile.FAST)
    return Episode("replay", "digest", task, seed, Protocol(horizon, 8, view))


def test_every_task_with_an_expert_has_a_demonstration_within_its_horizon():
    real = {task: card for task, card in task_descriptions().items() if task in WITH_EXPERTS}
    assert set(open_loop_replay.replays()) == set(real)
    assert all(0 < len(actions) <= real[task].horizon for task, actions in open_loop_replay.replays().items())


def test_the_demonstration_is_played_from_the_first_step_and_then_held():
    task = "robosuite/Lift"
    actions = open_loop_replay.replays()[task]
    queries = [Query(episode(task), step) for step in range(0, len(actions) + 9, 8)]
    found = np.concatenate([open_loop_replay.REPLAY.load({}).act([query])[0].actions for query in queries])
    np.testing.assert_array_equal(found[: len(actions)], actions)
    assert not found[len(actions) :, :6].any()
    assert (found[len(actions) :, 6] == actions[-1, 6]).all()


def write_dataset(folder, first_seed=FIRST_TRAINING_SEED, **source):
    recorded = [recording(first_seed + number, steps=8) for number in range(2)]
    write(folder, recorded, **{"noise": 0, **source})
    return recorded


def test_the_first_episode_of_given_datasets_is_played(tmp_path):
    first, _ = write_dataset(tmp_path / "data" / "Reach")
    options = {"demonstrations": str(tmp_path / "data")}
    policy = open_loop_replay.REPLAY.load(options)
    (decision,) = policy.act([Query(episode("null/Reach"), 0)])
    np.testing.assert_allclose(decision.actions, first.actions, atol=1e-6)
    assert policy.spec.tasks == {"null/Reach"}
    assert open_loop_replay.REPLAY.digest(options) != open_loop_replay.REPLAY.digest({})


def test_a_copy_of_its_files_is_the_same_policy(tmp_path):
    write_dataset(tmp_path / "data" / "Reach")
    options = {"demonstrations": str(tmp_path / "data")}
    places, files = bundle_layout(open_loop_replay.REPLAY.files(options))
    for place, file in files.items():
        (tmp_path / "copy" / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "copy" / place).write_bytes(file.read_bytes())
    copied = {"demonstrations": str(tmp_path / "copy" / places["demonstrations"])}
    assert open_loop_replay.REPLAY.digest(copied) == open_loop_replay.REPLAY.digest(options)


@pytest.mark.parametrize(
    ("demonstrations", "message"),
    [
        (7, "a folder of datasets, got 7"),
        ("", "a folder of datasets, got ''"),
        ("nowhere", "a folder of them, got none"),
        ("evaluated", "got 3: a policy"),
        ("noisy", "record it by --noise 0"),
        ("taken-over", "without a learner"),
        ("twice", "got several of one task"),
    ],
)
def test_demonstrations_that_cannot_be_played_are_refused(tmp_path, monkeypatch, demonstrations, message):
    monkeypatch.chdir(tmp_path)
    write_dataset(tmp_path / "evaluated" / "Reach", 3)
    write_dataset(tmp_path / "noisy" / "Reach", noise=0.1)
    write_dataset(tmp_path / "taken-over" / "Reach", learner="abc")
    for name in ("Reach", "Again"):
        write_dataset(tmp_path / "twice" / name)
    with pytest.raises(PolicyError, match=rf"^policy 'replay': [^\n]*{message}"):
        open_loop_replay.REPLAY.load({"demonstrations": demonstrations})


def test_a_task_without_a_demonstration_is_refused():
    with pytest.raises(PolicyError, match="expected a task with a recorded demonstration, got 'null/Reach'"):
        open_loop_replay.REPLAY.load({}).reset([episode("null/Reach")])


@pytest.mark.parametrize(
    "text", ["", "[]", '{"a": {}}', '{"a": {"actions": [[1, 2]]}}', json.dumps({"a": {"actions": [[None] * 7]}})]
)
def test_a_broken_file_is_refused_in_one_line(tmp_path, monkeypatch, text):
    file = tmp_path / "replays.json"
    file.write_text(text)
    monkeypatch.setattr(open_loop_replay, "FILE", file)
    open_loop_replay.replays.cache_clear()
    with pytest.raises(PolicyError, match=r"^replays.json: expected [^\n]*$"):
        open_loop_replay.replays()
    open_loop_replay.replays.cache_clear()


@pytest.mark.simulator
@pytest.mark.parametrize("task", ["maniskill/PushCube-v1", "pybullet/PandaReach-v3", "robosuite/Lift"])
def test_on_the_seed_that_it_was_recorded_on_it_succeeds(task):
    runner = EpisodeRunner({"replay": PolicySource("replay")})
    result = runner.play_one(episode(task, seed=1_000_000, horizon=task_descriptions()[task].horizon))
    runner.close()
    assert result.status == "success", result.error
