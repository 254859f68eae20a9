"""What training is given."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from policies.training.dataset import Demonstrations, find_datasets, pooled_hash
from policies.training.lerobot import DatasetError
from tests.policies.training.synthetic import recording, write

LENGTHS = (6, 12, 3)


@pytest.fixture
def recordings():
    return [recording(seed, steps) for seed, steps in enumerate(LENGTHS)]


@pytest.fixture
def dataset(tmp_path, recordings):
    write(tmp_path / "set", recordings)
    return Demonstrations(tmp_path / "set")


def test_what_was_recorded_comes_back(dataset, recordings):
    assert (len(dataset), dataset.episodes) == (sum(LENGTHS), 3)
    assert dataset.instructions == ("reach the goal",)
    for r, start, end in zip(recordings, dataset.starts, dataset.ends, strict=True):
        frames = np.arange(start, end)
        assert np.array_equal(dataset.states[frames], r.states.astype(np.float32))
        assert np.array_equal(dataset.actions[frames], r.actions.astype(np.float32))
        assert np.array_equal(dataset.success[frames], r.success)
        for camera in r.images:
            assert np.array_equal(dataset.images(camera, frames), np.stack(r.images[camera]))


def test_a_chunk_ends_with_its_episode(dataset, recordings):
    batch = dataset.batch(np.array([0, 3, 5]))
    assert batch.actions.shape == (3, 8, 7)
    assert batch.mask.sum(axis=1).tolist() == [6, 3, 1]
    assert np.array_equal(batch.actions[1, :3], recordings[0].actions[3:].astype(np.float32))
    assert np.array_equal(batch.states[1], recordings[0].states[3].astype(np.float32))
    assert np.all(batch.actions[1, 3:, :6] == 0.0)
    assert np.all(batch.actions[1, 3:, 6] == np.float32(recordings[0].actions[-1, 6]))


def test_reading_a_batch_does_not_change_the_data(dataset):
    before = dataset.actions.copy()
    dataset.batch(np.arange(len(dataset)))
    assert np.array_equal(dataset.actions, before)


def test_a_sample_depends_on_its_seed_and_step_alone(dataset):
    one, two = dataset.sample(5, seed=1, step=7), dataset.sample(5, seed=1, step=7)
    assert np.array_equal(one.actions, two.actions)
    assert not np.array_equal(one.actions, dataset.sample(5, seed=1, step=8).actions)
    assert not np.array_equal(one.actions, dataset.sample(5, seed=2, step=7).actions)


def test_preloaded_images_are_the_same(dataset):
    before = dataset.batch(np.array([2, 9]))
    dataset.preload()
    after = dataset.batch(np.array([2, 9]))
    for camera in dataset.spec.cameras:
        assert np.array_equal(before.images[camera], after.images[camera])


def test_the_hash_does_not_depend_on_files_or_order(dataset, recordings, tmp_path):
    write(tmp_path / "backwards", recordings[::-1], per_file=1)
    assert Demonstrations(tmp_path / "backwards").content_hash == dataset.content_hash
    write(tmp_path / "first", recordings[:1])
    write(tmp_path / "rest", recordings[1:])
    parts = [Demonstrations(tmp_path / name) for name in ("rest", "first")]
    assert pooled_hash(parts) == dataset.content_hash


def test_the_hash_notices_a_missing_episode(dataset, recordings, tmp_path):
    write(tmp_path / "fewer", recordings[:2])
    assert Demonstrations(tmp_path / "fewer").content_hash != dataset.content_hash


def test_an_unknown_camera_is_told(dataset):
    with pytest.raises(DatasetError, match="expected camera third_person, wrist, got front"):
        dataset.images("front", np.array([0]))


def test_datasets_are_found_below_a_folder(dataset, tmp_path):
    assert find_datasets(tmp_path) == [tmp_path / "set"]
    assert find_datasets(tmp_path / "set") == [tmp_path / "set"]
    with pytest.raises(DatasetError, match="expected a dataset"):
        find_datasets(tmp_path / "set" / "meta")


def test_what_is_no_dataset_is_refused_in_one_line(dataset, tmp_path):
    info, data = tmp_path / "set/meta/info.json", tmp_path / "set/data/chunk-000/file-000.parquet"
    sound, whole = json.loads(info.read_text()), data.read_bytes()

    def refused(pattern):
        with pytest.raises(DatasetError, match=pattern) as caught:
            Demonstrations(tmp_path / "set")
        assert "\n" not in str(caught.value)

    info.write_text(json.dumps({**sound, "codebase_version": "v2.1"}))
    refused("expected codebase_version v3.0, got v2.1")
    info.write_text(json.dumps({**sound, "total_frames": 99}))
    refused("expected frames 0 to 98 in order, got 21")
    info.write_text("{")
    refused("expected a LeRobot dataset: JSONDecodeError")
    info.write_text(json.dumps(sound))
    data.write_bytes(whole[:-100])
    refused("file-000.parquet: cannot be read")
    table = pq.read_table(tmp_path / "set/data/chunk-000/file-001.parquet")
    pq.write_table(table.drop_columns(["action"]), data)
    refused("expected a column action, there is none")
    info.unlink()
    refused("expected a LeRobot dataset: No such file")
