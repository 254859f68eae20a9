"""A dataset is written in steps, and committed episodes are kept."""

import json
import signal

import pandas as pd
import pyarrow.parquet as pq
import pytest

from robogauntlet.policies.training import dataset_writer
from robogauntlet.policies.training.dataset import Demonstrations
from robogauntlet.policies.training.dataset_writer import Attempt, DatasetWriter
from robogauntlet.policies.training.lerobot_format import DatasetError, encode_episode
from tests.policies.training.synthetic import SOURCE, recording, won, write


@pytest.fixture
def recordings():
    return [recording(seed, steps=6 + seed) for seed in range(5)]


def test_the_files_are_those_of_lerobot_v3(tmp_path, recordings):
    write(tmp_path, recordings)
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 20, "panda")
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (5, 40, 1)
    assert info["splits"] == {"train": "0:5"}
    assert info["features"]["observation.images.wrist"]["shape"] == [16, 16, 3]
    names = {path.name for path in (tmp_path / "data/chunk-000").iterdir()}
    assert names == {f"file-00{number}.parquet" for number in range(3)}
    tasks = pd.read_parquet(tmp_path / "meta/tasks.parquet")
    assert tasks.loc["reach the goal", "task_index"] == 0
    episodes = pd.read_parquet(tmp_path / "meta/episodes/chunk-000/file-000.parquet")
    assert episodes["length"].tolist() == [6, 7, 8, 9, 10]
    assert episodes["dataset_from_index"].tolist() == [0, 6, 13, 21, 30]
    assert episodes["data/file_index"].tolist() == [0, 0, 1, 1, 2]
    assert episodes["seed"].tolist() == [0, 1, 2, 3, 4]
    assert set(json.loads((tmp_path / "meta/stats.json").read_text())) == set(info["features"])


def test_a_data_file_has_a_row_group_per_episode(tmp_path, recordings):
    write(tmp_path, recordings)
    assert pq.ParquetFile(tmp_path / "data/chunk-000/file-001.parquet").num_row_groups == 2


def test_a_continued_dataset_equals_one_written_at_once(tmp_path, recordings):
    at_once = write(tmp_path / "at_once", recordings)
    write(tmp_path / "later", recordings[:3])
    later = write(tmp_path / "later", recordings[3:])
    assert (later.episodes, later.frames) == (at_once.episodes, at_once.frames)
    assert later.content_hash == at_once.content_hash == Demonstrations(tmp_path / "later").content_hash
    stats = [json.loads((tmp_path / name / "meta/stats.json").read_text()) for name in ("at_once", "later")]
    assert stats[0] == stats[1]


@pytest.mark.parametrize(("size", "age_s"), [(0, 0.0), (2**40, 11.0)])
def test_added_episodes_are_committed_together_when_large_or_old(tmp_path, recordings, monkeypatch, size, age_s):
    monkeypatch.setattr("robogauntlet.policies.training.dataset_writer.FLUSH_BYTES", size)
    clock = [0.0]
    writer = DatasetWriter(tmp_path, SOURCE, now=lambda: clock[0])
    writer.add(Attempt(7, "failure", 60), None)
    writer.flush_if_due()
    assert writer.attempts == []
    for each in recordings[:2]:
        writer.add(won(each), encode_episode(each))
    clock[0] = age_s
    writer.flush_if_due()
    assert [attempt.seed for attempt in writer.attempts] == [7, 0, 1]
    assert (writer.episodes, Demonstrations(tmp_path).episodes) == (2, 2)
    assert len(list((tmp_path / "data/chunk-000").iterdir())) == 1


def test_pending_episodes_are_not_part_of_the_dataset(tmp_path, recordings):
    writer = write(tmp_path, recordings[:1])
    writer.add(won(recordings[1]), encode_episode(recordings[1]))
    assert DatasetWriter(tmp_path, SOURCE).episodes == 1
    writer.flush()
    writer.flush()
    assert DatasetWriter(tmp_path, SOURCE).episodes == 2


def test_ctrl_c_during_a_commit_loses_no_episode(tmp_path, recordings, monkeypatch):
    write_json = dataset_writer._write_json

    def interrupt(*arguments):
        signal.raise_signal(signal.SIGINT)
        write_json(*arguments)

    writer = DatasetWriter(tmp_path, SOURCE)
    for each in recordings[:2]:
        writer.add(won(each), encode_episode(each))
    monkeypatch.setattr(dataset_writer, "_write_json", interrupt)
    with pytest.raises(KeyboardInterrupt):
        writer.flush()
    assert DatasetWriter(tmp_path, SOURCE).episodes == 2


def test_failures_are_counted_and_not_stored(tmp_path, recordings):
    writer = write(tmp_path, recordings[:1])
    writer.commit([Attempt(1, "failure", 60), won(recordings[2])], [encode_episode(recordings[2])])
    again = DatasetWriter(tmp_path, SOURCE)
    assert [attempt.status for attempt in again.attempts] == ["success", "failure", "success"]
    assert (again.episodes, Demonstrations(tmp_path).episodes) == (2, 2)


def test_leftovers_of_a_killed_process_are_overwritten(tmp_path, recordings):
    write(tmp_path, recordings[:2])
    journal = (tmp_path / "meta/robogauntlet.json").read_text()
    write(tmp_path, recordings[2:4])
    (tmp_path / "meta/robogauntlet.json").write_text(journal)
    write(tmp_path, recordings[2:])
    write(tmp_path / "undisturbed", recordings)
    assert Demonstrations(tmp_path).content_hash == Demonstrations(tmp_path / "undisturbed").content_hash


def test_a_dataset_that_was_killed_in_its_first_commit_is_continued(tmp_path, recordings, monkeypatch):
    def die(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(DatasetWriter, "_statistics", die)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path, recordings)
    monkeypatch.undo()
    assert write(tmp_path, recordings).content_hash == Demonstrations(tmp_path).content_hash


def test_a_dataset_of_another_source_is_not_continued(tmp_path, recordings):
    write(tmp_path, recordings)
    with pytest.raises(DatasetError, match=r"it was begun with noise 0.1, now 0.2; choose another --out"):
        DatasetWriter(tmp_path, {**SOURCE, "noise": 0.2})


def test_a_dataset_of_another_origin_is_unchanged(tmp_path):
    (tmp_path / "meta").mkdir()
    with pytest.raises(DatasetError, match="expected an empty folder or a dataset of ours"):
        DatasetWriter(tmp_path, SOURCE)


def test_a_broken_record_of_attempts_is_an_error(tmp_path, recordings):
    write(tmp_path, recordings)
    (tmp_path / "meta/robogauntlet.json").write_text("{")
    with pytest.raises(DatasetError, match="expected a record of attempts: JSONDecodeError"):
        DatasetWriter(tmp_path, SOURCE)
    (tmp_path / "meta/robogauntlet.json").write_text('{"source": 5, "data_files": 0, "episodes": 0, "attempts": []}')
    with pytest.raises(DatasetError, match="expected a record of attempts: TypeError"):
        DatasetWriter(tmp_path, SOURCE)


def test_episodes_that_do_not_fit_are_refused(tmp_path, recordings):
    writer = write(tmp_path, recordings)
    other = recording(9, size=8)
    with pytest.raises(DatasetError, match="expected episodes of DatasetSpec"):
        writer.commit([won(other)], [encode_episode(other)])
    with pytest.raises(DatasetError, match=r"expected episodes of the kept seeds \[9\], got \[\]"):
        writer.commit([won(other)], [])
