"""First observations of recorded demonstrations."""

import numpy as np
import pytest

from robogauntlet.policies.training.dataset import Demonstrations
from robogauntlet_mergevla.routing.contract import RoutingError
from robogauntlet_mergevla.routing.demonstrations import first_observations
from tests.policies.training.synthetic import recording, write

CAMERAS = ("wrist", "third_person")


def dataset(folder, episodes, task="null/Reach", **source):
    recordings = [recording(seed, 6 + seed) for seed in range(episodes)]
    write(folder, recordings, task=task, **source)
    return Demonstrations(folder), recordings


def test_the_first_frame_of_every_episode_is_split_four_to_one(tmp_path):
    found, recordings = dataset(tmp_path / "set", 9)
    split = first_observations([found], CAMERAS)
    assert split.frames.keys() == split.held_out.keys() == {"null/Reach"}
    frames, held_out = split.frames["null/Reach"], split.held_out["null/Reach"]
    assert (len(frames), len(held_out)) == (7, 2)
    for one, original in zip(held_out, [recordings[3], recordings[7]], strict=True):
        expected = np.stack([original.images[camera][0] for camera in CAMERAS]).transpose(0, 3, 1, 2) / 255.0
        assert one.images.numpy() == pytest.approx(expected, abs=1e-6)
        assert one.proprioception == pytest.approx(original.states[0], abs=1e-6)
        assert (one.instruction, one.task) == (original.instruction, "null/Reach")
    assert len({one.episode_id for one in [*frames, *held_out]}) == 9


def test_datasets_of_one_task_are_joined(tmp_path):
    parts = [dataset(tmp_path / name, count)[0] for name, count in (("one", 4), ("two", 2))]
    split = first_observations(parts, CAMERAS)
    assert (len(split.frames["null/Reach"]), len(split.held_out["null/Reach"])) == (4, 2)


def test_every_task_has_as_many_as_the_one_with_the_fewest(tmp_path):
    few, many = dataset(tmp_path / "few", 4)[0], dataset(tmp_path / "many", 12, "null/Other")[0]
    split = first_observations([few, many], CAMERAS)
    assert {task: len(found) for task, found in split.frames.items()} == {"null/Reach": 3, "null/Other": 3}
    assert {task: len(found) for task, found in split.held_out.items()} == {"null/Reach": 1, "null/Other": 1}


def test_episodes_that_begin_where_a_learner_stopped_are_left_out(tmp_path):
    begun, taken_over = dataset(tmp_path / "begun", 4)[0], dataset(tmp_path / "over", 4, learner="0")[0]
    split = first_observations([begun, taken_over, dataset(tmp_path / "whole", 4, learner="0", whole=True)[0]], CAMERAS)
    assert (len(split.frames["null/Reach"]), len(split.held_out["null/Reach"])) == (6, 2)
    with pytest.raises(RoutingError, match="expected demonstrations of null/Reach from their first step"):
        first_observations([taken_over], CAMERAS)


def test_a_dataset_that_cannot_be_split_is_refused(tmp_path):
    with pytest.raises(RoutingError, match="expected two episodes or more, got 1"):
        first_observations([dataset(tmp_path / "set", 1)[0]], CAMERAS)


def test_a_camera_that_was_not_recorded_is_refused(tmp_path):
    with pytest.raises(RoutingError, match="expected camera overhead, got third_person, wrist"):
        first_observations([dataset(tmp_path / "set", 2)[0]], ("overhead",))
