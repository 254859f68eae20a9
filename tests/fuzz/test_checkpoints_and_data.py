"""Exported runs, checkpoints and datasets: whatever their files hold, they are read or refused in one line."""

import json
import shutil

import pytest
from hypothesis import example

from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.training.dataset import Demonstrations
from robogauntlet.policies.training.lerobot_format import DatasetError
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.exported_run import import_run
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, read_tensors
from robogauntlet_mergevla.checkpoints.metadata import CheckpointError, hash_tensors
from tests.fuzz.damage import damaged_bytes, damaged_value, fuzzed, in_one_line

INFO, TASKS, JOURNAL = "meta/info.json", "meta/tasks.parquet", "meta/robogauntlet.json"
FRAMES = "data/chunk-000/file-000.parquet"
INFOS = (
    b'{"codebase_version": "v3.0", "total_episodes": Infinity, "total_frames": 1}',
    b'{"codebase_version": "a\\nb", "total_episodes": 1, "total_frames": 1, "features": {}}',
)
FLOAT = b'{"a": {"dtype": "F32", "shape": [1], "data_offsets": [0.0, 4]}}'
ONCE_BADLY_ANSWERED = (
    b"[" * 100_000,
    (100_000).to_bytes(8, "little") + b"[" * 100_000,
    len(FLOAT).to_bytes(8, "little") + FLOAT + b"\0" * 4,
)


@pytest.fixture(scope="session")
def strategies(good_files):
    """For each file, a strategy of its content with damage."""
    expert, data = good_files / "experts" / "null-Reach", good_files / "data" / "Reach"
    return {
        "exported": damaged_bytes((good_files / "run.zip").read_bytes()),
        "card.json": as_json(expert / "card.json"),
        "base": as_json(good_files / "base" / "card.json"),
        "model.safetensors": damaged_bytes((expert / "model.safetensors").read_bytes()),
        "header": damaged_header((expert / "model.safetensors").read_bytes()),
        INFO: as_json(data / INFO),
        JOURNAL: as_json(data / JOURNAL),
        TASKS: damaged_bytes((data / TASKS).read_bytes()),
        FRAMES: damaged_bytes((data / FRAMES).read_bytes()),
    }


def as_json(file):
    text = file.read_bytes()
    return damaged_bytes(text) | damaged_value(json.loads(text)).map(lambda value: json.dumps(value).encode())


def damaged_header(content):
    """Files of tensors whose header has damage, and fits its length."""
    length = int.from_bytes(content[:8], "little")
    header, tensors = content[8 : 8 + length], content[8 + length :]
    headers = damaged_bytes(header) | damaged_value(json.loads(header)).map(lambda value: json.dumps(value).encode())
    return headers.map(lambda text: len(text).to_bytes(8, "little") + text + tensors)


def check_all(strategy, read, *examples, share=1.0):
    """Give damaged content to `read`, beginning with examples of what was once answered badly."""

    def answer(damaged):
        read(damaged)

    for content in examples:
        answer = example(damaged=content)(answer)
    fuzzed(strategy, share)(answer)()


def test_a_damaged_exported_run(strategies, tmp_path):
    def read(content):
        file = tmp_path / "run.zip"
        file.write_bytes(content)
        try:
            import_run(file, tmp_path / "there")
            shutil.rmtree(tmp_path / "there")
        except RunError as error:
            in_one_line(error)

    check_all(strategies["exported"], read)


@pytest.mark.parametrize(
    ("damaged", "written"),
    [
        ("card.json", "experts/null-Reach/card.json"),
        ("base", "base/card.json"),
        ("model.safetensors", "experts/null-Reach/model.safetensors"),
        ("header", "experts/null-Reach/model.safetensors"),
    ],
    ids=["metadata of an expert", "metadata of a base", "weights", "header of the weights"],
)
def test_a_damaged_checkpoint(strategies, good_files, tmp_path, damaged, written):
    for name in ("base", "experts"):
        shutil.copytree(good_files / name, tmp_path / name)
    file = tmp_path / written

    def read(content):
        file.unlink()  # hashes are remembered by the file, not by its name
        file.write_bytes(content)
        refusable(lambda: load_checkpoint(file.parent), PolicyError)
        if written.endswith(".safetensors"):
            refusable(lambda: hash_tensors(file), CheckpointError)
            refusable(lambda: read_tensors(file), CheckpointError)

    check_all(strategies[damaged], read, *ONCE_BADLY_ANSWERED)


@pytest.mark.parametrize("written", [INFO, JOURNAL, TASKS, FRAMES])
def test_a_damaged_dataset(strategies, good_files, tmp_path, written):
    folder = tmp_path / "Reach"
    shutil.copytree(good_files / "data" / "Reach", folder)

    whole = (folder / written).read_bytes()
    no_type, no_name = whole.replace(b'"unicode"', b'"umicode"'), whole.replace(b"task_index", b"\xe5ask_index")

    def read(content):
        (folder / written).write_bytes(content)
        refusable(lambda: use(Demonstrations(folder)), DatasetError)

    check_all(strategies[written], read, b"[" * 100_000, no_type, no_name, *(INFOS if written == INFO else ()))


def use(dataset):
    """Read what a training reads of a dataset."""
    assert isinstance(dataset.task, str)
    assert all(isinstance(text, str) for text in dataset.instructions)
    assert dataset.starts_midway in (True, False)
    for camera in dataset.spec.cameras:
        dataset.images(camera, range(len(dataset)))


def refusable(read, kind):
    """Read something, which may be refused by a kind of error with one line."""
    try:
        read()
    except kind as error:
        in_one_line(error)
