"""Reading datasets for training."""

import errno
import json
import os
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from robogauntlet.adapters.contract import Body
from robogauntlet.policies.training.dataset import Demonstrations, find_datasets, pooled_hash
from robogauntlet.policies.training.lerobot_format import DatasetError, decode_png, image_key
from robogauntlet_mergevla.training.dataset_mixture import LARGEST_SHARE, DatasetMixture
from tests.errors import one_line_error
from tests.policies.training.synthetic import recording, write

LENGTHS = (6, 12, 3)
IMAGE_FILES = pa.array([{"bytes": None, "path": "frame.png"}] * 12)
NO_IMAGES = pa.array([{"bytes": b"abc", "path": None}] * 12)


@pytest.fixture
def recordings():
    return [recording(seed, steps) for seed, steps in enumerate(LENGTHS)]


@pytest.fixture
def dataset(tmp_path, recordings):
    write(tmp_path / "set", recordings)
    return Demonstrations(tmp_path / "set")


def replace_column(file, column, values):
    table = pq.read_table(file)
    pq.write_table(table.set_column(table.column_names.index(column), column, values), file)


def test_recorded_episodes_are_read_back(dataset, recordings):
    assert (len(dataset), dataset.episodes) == (sum(LENGTHS), 3)
    assert dataset.instructions == ("reach the goal",)
    for r, start, end in zip(recordings, dataset.starts, dataset.ends, strict=True):
        frames = np.arange(start, end)
        assert np.array_equal(dataset.states[frames], r.states.astype(np.float32))
        assert np.array_equal(dataset.actions[frames], r.actions.astype(np.float32))
        assert np.array_equal(dataset.success[frames], r.success)
        for camera in r.images:
            assert np.array_equal(dataset.images(camera, frames), np.stack(r.images[camera]))


def test_demonstrations_of_two_arms_are_read_back_and_mixed_with_those_of_one(tmp_path, dataset):
    recorded = recording(states=np.ones((12, 16)), actions=np.full((12, 14), 0.5), body=Body(2))
    write(tmp_path / "two", [recorded], task="null/Two")
    read = Demonstrations(tmp_path / "two")
    assert np.array_equal(read.actions, recorded.actions.astype(np.float32))
    assert read.states.shape == (12, 16)
    last = read.batch(np.array([11]), chunk_length=2).actions[0, 1]
    assert last.tolist() == ([0.0] * 6 + [0.5]) * 2, "past the end: no motion, the grippers' last commands"
    batch = DatasetMixture([dataset, read]).sample(32, seed=0, step=0, chunk_length=2)
    of_one = np.array(batch.tasks) == dataset.task
    assert 0 < of_one.sum() < 32
    assert batch.states.shape == (32, 16)
    assert not batch.states[of_one, 8:].any()
    assert not batch.actions[of_one, :, 7:].any()
    assert batch.actions[~of_one, 0, 7:].all()


def test_a_task_has_one_body(tmp_path):
    write(tmp_path / "one", [recording()])
    write(tmp_path / "two", [recording(states=np.ones((12, 16)), actions=np.zeros((12, 14)), body=Body(2))])
    datasets = [Demonstrations(tmp_path / name) for name in ("one", "two")]
    expected = "two: expected actions of dx, .*, gripper, as in another dataset of null/Reach, got dx, .*second_gripper"
    with one_line_error(DatasetError, expected):
        DatasetMixture(datasets)


def test_demonstrations_with_the_targets_of_joints_are_read_back_with_their_names(tmp_path):
    body = Body(joints=("shoulder", "elbow"))
    recorded = recording(states=np.ones((12, 3)), actions=np.full((12, 3), 0.5), body=body)
    write(tmp_path, [recorded])
    read = Demonstrations(tmp_path)
    assert read.spec.body == body
    assert np.array_equal(read.actions, recorded.actions.astype(np.float32))
    assert np.array_equal(read.batch(np.array([11])).actions[0], np.full((8, 3), 0.5))
    mixture = DatasetMixture([read])
    assert (mixture.action_dim, mixture.proprioception_dim) == (3, 3)
    assert mixture.statistics.of("null/Reach").of_joints


def test_recordings_of_native_numbers_are_read_back_with_their_names_and_not_trained_on(tmp_path):
    body = Body(native=("x", "y"), state=("x", "y", "speed"))
    write(tmp_path, [recording(states=np.ones((12, 3)), actions=np.full((12, 2), 300.0), body=body)])
    read = Demonstrations(tmp_path)
    assert read.spec.body == body
    with one_line_error(DatasetError, "expected actions of a robot, got numbers of the environment's own"):
        DatasetMixture([read])


def test_velocities_of_joints_of_two_arms_are_read_back_and_end_with_their_episode(tmp_path):
    body = Body(2, ("shoulder", "elbow"), velocities=True)
    recorded = recording(states=np.ones((12, 6)), actions=np.full((12, 6), 0.5), body=body)
    write(tmp_path, [recorded])
    read = Demonstrations(tmp_path)
    assert read.spec.body == body
    assert np.array_equal(read.batch(np.array([11])).actions[0, 1], [0.0, 0.0, 0.5] * 2)


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
    def drawn(seed, step):
        return DatasetMixture([dataset]).sample(5, seed=seed, step=step, chunk_length=8).actions.tobytes()

    assert drawn(1, 7) == drawn(1, 7)
    assert len({drawn(1, 7), drawn(1, 8), drawn(2, 7)}) == 3


def test_preloaded_images_are_the_same(dataset):
    before = dataset.batch(np.array([2, 9]))
    dataset.preload()
    after = dataset.batch(np.array([2, 9]))
    for camera in dataset.spec.cameras:
        assert np.array_equal(before.images[camera], after.images[camera])


def test_images_are_preloaded_one_data_file_after_another(recordings, tmp_path, monkeypatch):
    """So that all encoded and all decoded images are never in memory together."""
    write(tmp_path / "set", recordings, per_file=1)
    dataset, events = Demonstrations(tmp_path / "set"), []

    def logged(event, function):
        return lambda *given, **options: (events.append(event), function(*given, **options))[1]

    monkeypatch.setattr(pq, "ParquetFile", logged("file", pq.ParquetFile))
    module = "robogauntlet.policies.training.dataset"
    monkeypatch.setattr(f"{module}.decode_png", logged("image", decode_png))
    dataset.preload()
    assert [event for event, _ in groupby(events)] == ["file", "image"] * len(LENGTHS)


def test_images_that_do_not_fit_into_memory_are_refused_in_one_line(tmp_path, monkeypatch):
    write(tmp_path, [recording(1_000_000, 6)])
    needed = 6 * 2 * 16**2 * 3 / LARGEST_SHARE
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=needed + 1))
    DatasetMixture.open([tmp_path])
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=needed - 1))
    with one_line_error(DatasetError, "expected at most 0.0 GB of decoded images, 80% of the available memory"):
        DatasetMixture.open([tmp_path])


def test_the_hash_does_not_depend_on_files_or_order(dataset, recordings, tmp_path):
    write(tmp_path / "backwards", recordings[::-1], per_file=1)
    assert Demonstrations(tmp_path / "backwards").content_hash == dataset.content_hash
    write(tmp_path / "first", recordings[:1])
    write(tmp_path / "rest", recordings[1:])
    parts = [Demonstrations(tmp_path / name) for name in ("rest", "first")]
    assert pooled_hash(parts) == dataset.content_hash


def test_the_hash_changes_without_an_episode(dataset, recordings, tmp_path):
    write(tmp_path / "fewer", recordings[:2])
    assert Demonstrations(tmp_path / "fewer").content_hash != dataset.content_hash


def test_an_unknown_camera_is_an_error(dataset):
    with pytest.raises(DatasetError, match="expected camera third_person, wrist, got front"):
        dataset.images("front", np.array([0]))


def test_datasets_are_found_below_a_folder(dataset, tmp_path):
    assert find_datasets([tmp_path]) == [tmp_path / "set"]
    assert find_datasets([tmp_path / "set"]) == [tmp_path / "set"]
    with pytest.raises(DatasetError, match="expected a dataset"):
        find_datasets([tmp_path / "set" / "meta"])


@pytest.mark.parametrize(
    "name",
    [
        "meta/tasks.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "data/chunk-000/file-000.parquet",
        "meta/robogauntlet.json",
    ],
)
def test_a_pipe_in_place_of_a_file_is_refused_without_waiting(dataset, name):
    (dataset.folder / name).unlink(missing_ok=True)
    (dataset.folder / name).parent.mkdir(exist_ok=True)
    os.mkfifo(dataset.folder / name)
    with one_line_error(DatasetError, "a named pipe, no regular file"):
        _ = (read := Demonstrations(dataset.folder)).seeds, read.is_replayable


def test_an_unreadable_dataset_is_an_error(dataset, recordings, tmp_path, monkeypatch):
    """The error is simulated, since root may read everything."""
    write(tmp_path / "other", recordings)
    is_file = Path.is_file

    def deny(path):
        if tmp_path / "set" in path.parents:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return is_file(path)

    monkeypatch.setattr(Path, "is_file", deny)
    with pytest.raises(DatasetError, match=f"{tmp_path / 'set/meta/info.json'}: cannot be read: Permission denied"):
        find_datasets([tmp_path])


def test_a_data_file_that_is_cut_or_lacks_a_column_is_refused_in_one_line(dataset, tmp_path):
    data = tmp_path / "set/data/chunk-000/file-000.parquet"
    data.write_bytes(data.read_bytes()[:-100])
    with one_line_error(DatasetError, "file-000.parquet: cannot be read"):
        Demonstrations(tmp_path / "set")
    table = pq.read_table(tmp_path / "set/data/chunk-000/file-001.parquet")
    pq.write_table(table.drop_columns(["action"]), data)
    with one_line_error(DatasetError, "expected a column action, got none"):
        Demonstrations(tmp_path / "set")


def test_a_dataset_without_episodes_is_refused(tmp_path):
    write(tmp_path, [recording()])
    info, data = tmp_path / "meta/info.json", tmp_path / "data/chunk-000/file-000.parquet"
    info.write_text(json.dumps({**json.loads(info.read_text()), "total_frames": 0, "total_episodes": 0}))
    pq.write_table(pq.read_table(data).slice(0, 0), data)
    with pytest.raises(DatasetError, match="expected at least one episode, got none"):
        Demonstrations(tmp_path)


@pytest.mark.parametrize(
    ("column", "values", "message"),
    [
        ("next.success", pa.array([None] * 12, pa.bool_()), "next.success: expected numbers in each frame"),
        ("action", pa.array([[None] * 7] * 12, pa.list_(pa.float32(), 7)), "action: expected numbers in each frame"),
        ("next.success", pa.array(["no"] * 12), "next.success: expected numbers in each frame"),
        ("next.success", pa.array([[True]] * 12), "next.success: expected numbers in each frame"),
        ("action", pa.array([[0.0] * 6] * 12, pa.list_(pa.float32(), 6)), "expected 7 numbers per frame, got 6"),
        (image_key("wrist"), IMAGE_FILES, "wrist: expected images within the data files"),
        (image_key("wrist"), pa.array([None] * 12, IMAGE_FILES.type), "wrist: expected images within the data files"),
        (image_key("wrist"), NO_IMAGES, "wrist: expected a PNG image, got 3 bytes of another format"),
    ],
)
def test_unsuitable_columns_are_refused_in_one_line(column, values, message, tmp_path):
    write(tmp_path, [recording()])
    data = tmp_path / "data/chunk-000/file-000.parquet"
    replace_column(data, column, values)
    with one_line_error(DatasetError, f"{tmp_path}.*{message}"):
        Demonstrations(tmp_path).preload()


def test_data_files_of_other_columns_than_the_first_are_refused(dataset, tmp_path):
    data = tmp_path / "set/data/chunk-000/file-001.parquet"
    replace_column(data, "next.success", pa.array(["no"] * LENGTHS[2]))
    with pytest.raises(DatasetError, match=r"file-001\.parquet: expected next.success as in file-000\.parquet"):
        Demonstrations(tmp_path / "set")


def test_a_broken_record_of_the_collection_is_an_error(tmp_path):
    write(tmp_path, [recording()])
    assert Demonstrations(tmp_path).task == "null/Reach"
    (tmp_path / "meta/robogauntlet.json").write_text("{")
    with pytest.raises(DatasetError, match=r"robogauntlet\.json: cannot be read: JSONDecodeError"):
        Demonstrations(tmp_path).task  # noqa: B018
    (tmp_path / "meta/robogauntlet.json").unlink()
    assert Demonstrations(tmp_path).task == tmp_path.name


def test_the_message_for_a_killed_collection_says_how_to_continue(dataset, tmp_path):
    folder = tmp_path / "set/data/chunk-000"
    (folder / "file-002.parquet").write_bytes((folder / "file-000.parquet").read_bytes())
    with pytest.raises(DatasetError, match="got 39; if it was being collected, give the same command to continue"):
        Demonstrations(tmp_path / "set")
