"""Which checkpoints are in the folder of a training, and which are written whole."""

import json
import shutil

import pytest

from robogauntlet.orchestrator.runs.checkpoint_folder import (
    ReadyCheckpoints,
    fault_of,
    find_checkpoints,
    step_of,
    training_folder,
)


def write(folder, name, files=("config.json",)):
    """A checkpoint whose files are whole."""
    (folder / name).mkdir(parents=True, exist_ok=True)
    for file in files:
        (folder / name / file).write_bytes(tensors() if file.endswith(".safetensors") else b"{}")


def tensors():
    header = json.dumps({"w": {"dtype": "F32", "shape": [4], "data_offsets": [0, 16]}, "__metadata__": {}}).encode()
    return len(header).to_bytes(8, "little") + header + bytes(16)


@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("checkpoint-500", 500),
        ("000500", 500),
        ("epoch=3-step=1500", 1500),
        ("act_v2_step_20000_loss0.12", 20000),
        ("epoch-12", 12),
        ("runs", None),
        ("tmp-checkpoint-500", None),
        (".checkpoint-500", None),
        ("9" * 40, None),
    ],
)
def test_the_step_is_in_the_name(name, step):
    assert step_of(name) == step


def test_the_newest_checkpoint_comes_first_and_links_and_files_are_none(tmp_path):
    for name in ("checkpoint-900", "checkpoint-1000", "checkpoint-20", "logs"):
        write(tmp_path, name)
    (tmp_path / "last-1000").symlink_to(tmp_path / "checkpoint-1000")
    (tmp_path / "step-3.json").write_text("{}")
    assert [one.name for one in find_checkpoints(tmp_path)] == ["checkpoint-1000", "checkpoint-900", "checkpoint-20"]
    assert find_checkpoints(tmp_path / "nowhere") == []


def test_of_lerobots_checkpoints_the_policy_counts(tmp_path):
    write(tmp_path / "checkpoints" / "000500", "pretrained_model")
    write(tmp_path / "checkpoints" / "000500", "training_state")
    (one,) = find_checkpoints(training_folder(tmp_path))
    assert (one.step, one.name) == (500, "000500")
    assert one.folder == tmp_path / "checkpoints" / "000500" / "pretrained_model"
    assert training_folder(tmp_path / "checkpoints") == training_folder(tmp_path)


def test_a_checkpoint_is_whole_if_its_files_can_be_read(tmp_path):
    write(tmp_path, "a", ("config.json", "model.safetensors", "weights.pt"))
    assert fault_of(tmp_path / "a") is None


@pytest.mark.parametrize(
    ("file", "content", "fault"),
    [
        ("config.json", b'{"rate": ', "config.json cannot be read: Expecting value"),
        ("model.safetensors", tensors()[:-4], "model.safetensors cannot be read: expected 106 bytes, got 102"),
        ("model.safetensors", tensors()[:20], "model.safetensors cannot be read: "),
        ("model.safetensors", b"", "model.safetensors cannot be read: "),
        ("model.safetensors", bytes([2, *[0] * 7]) + b"[]", "model.safetensors cannot be read: "),
    ],
)
def test_what_is_not_whole_is_named(tmp_path, file, content, fault):
    write(tmp_path, "a")
    (tmp_path / "a" / file).write_bytes(content)
    assert fault_of(tmp_path / "a").startswith(fault)


@pytest.fixture
def looking(tmp_path):
    """Looks at a folder at a time (s): names of what is ready, and the lines so far."""
    clock, lines = [0.0], []
    ready = ReadyCheckpoints(tmp_path, 10.0, lines.append, lambda: clock[0])

    def look(at, done=()):
        clock[0] = at
        return [one.name for one in ready.look(done)]

    look.ready, look.lines = ready, lines
    return look


def test_a_checkpoint_is_ready_once_its_files_stay_unchanged(tmp_path, looking):
    write(tmp_path, "checkpoint-1")
    assert looking(0) == looking(9) == []
    write(tmp_path, "checkpoint-1", ("config.json", "model.safetensors"))  # it goes on
    write(tmp_path, "checkpoint-2")
    assert looking(11) == looking(20) == []
    assert looking(21) == ["checkpoint-2", "checkpoint-1"]
    assert looking(30, done={"checkpoint-2"}) == ["checkpoint-1"]
    assert looking.ready.changed_at == 11
    assert looking.lines == []


def test_an_empty_folder_is_not_ready(tmp_path, looking):
    (tmp_path / "checkpoint-1").mkdir()
    assert looking(0) == looking(100) == []
    assert looking.lines == []


def test_a_half_written_checkpoint_is_one_line_and_ready_when_it_is_whole(tmp_path, looking):
    write(tmp_path, "checkpoint-1", ("model.safetensors",))
    whole = (tmp_path / "checkpoint-1" / "model.safetensors").read_bytes()
    (tmp_path / "checkpoint-1" / "model.safetensors").write_bytes(whole[:-1])
    assert [looking(at) for at in (0, 10, 20)] == [[], [], []]
    assert looking.lines == ["checkpoint-1: not whole: model.safetensors cannot be read: expected 106 bytes, got 105"]
    (tmp_path / "checkpoint-1" / "model.safetensors").write_bytes(whole)
    assert looking(21) == []
    assert looking(31) == ["checkpoint-1"]
    assert len(looking.lines) == 1


def test_a_refused_checkpoint_comes_again_only_if_it_changes(tmp_path, looking):
    write(tmp_path, "checkpoint-1")
    looking(0)
    (one,) = looking.ready.look() or find_checkpoints(tmp_path)
    looking.ready.refuse(one, "not played: of another kind")
    assert looking(50) == []
    write(tmp_path, "checkpoint-1", ("config.json", "card.json"))
    assert looking(51) == []
    assert looking(61) == ["checkpoint-1"]


def test_a_deleted_checkpoint_is_said_to_be_so(tmp_path, looking):
    write(tmp_path, "checkpoint-1")
    looking(0)
    (one,) = find_checkpoints(tmp_path)
    shutil.rmtree(one.folder)
    looking.ready.refuse(one, "stopped: no weights")
    assert looking.lines == ["checkpoint-1: deleted; stopped: no weights"]
    assert looking(50) == []
