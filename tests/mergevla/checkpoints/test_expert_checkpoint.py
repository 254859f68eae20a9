"""Saving and loading checkpoints, and errors of one line."""

import errno
import json
import os
import pickle
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.hub import OnHub, without_downloads
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, load_tensors, save_checkpoint
from robogauntlet_mergevla.checkpoints.metadata import (
    METADATA_FILE,
    WEIGHTS,
    CheckpointError,
    CheckpointMetadata,
    base_folder,
    digest_of,
    hash_tensors,
    locate,
)
from robogauntlet_mergevla.network.config import LoraSettings
from robogauntlet_mergevla.network.lora import add_lora
from tests.errors import one_line_error
from tests.full_disk import full_disk
from tests.mergevla.shared import SMALL, inputs, small_model, task_statistics


def example_metadata(**changes):
    return replace(CheckpointMetadata(SMALL, task_statistics(), data_hash="d", metrics={"l1": 0.1}), **changes)


@pytest.fixture
def saved(tmp_path):
    save_checkpoint(tmp_path / "expert", small_model(), example_metadata())
    return tmp_path / "expert"


def rewrite(folder, **changes):
    metadata = json.loads((folder / METADATA_FILE).read_text())
    (folder / METADATA_FILE).write_text(json.dumps({**metadata, **changes}))


def refused(folder, match):
    with one_line_error(PolicyError, match):
        load_checkpoint(folder)


def test_a_saved_checkpoint_loads_unchanged(saved):
    checkpoint = load_checkpoint(saved)
    assert checkpoint.metadata == example_metadata(tensor_hash=checkpoint.metadata.tensor_hash)
    assert torch.equal(checkpoint.model(*inputs(SMALL)), small_model()(*inputs(SMALL)))
    assert sorted(file.name for file in saved.iterdir()) == [METADATA_FILE, WEIGHTS]


def test_whoever_may_read_the_metadata_may_read_the_weights(saved):
    assert {path.stat().st_mode for path in saved.iterdir()} == {(saved / METADATA_FILE).stat().st_mode}


def test_adapters_are_loaded_as_factors_by_the_plain_networks_names(tmp_path):
    model = small_model()
    add_lora(model, LoraSettings(rank=2), seed=7)
    save_checkpoint(tmp_path, model, example_metadata(lora=LoraSettings(rank=2)))
    back = load_checkpoint(tmp_path).model
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), back.parameters(), strict=True))
    assert [a.requires_grad for a in model.parameters()] == [b.requires_grad for b in back.parameters()]
    tensors, _ = load_tensors(tmp_path)
    layer = "backbone.language.layers.0.self_attn.q_proj"
    assert {f"{layer}.weight", f"{layer}.lora_A", f"{layer}.lora_B"} <= tensors.keys()


def test_tensors_of_a_base_are_stored_once_and_both_folders_can_move_together(saved, tmp_path):
    model = load_checkpoint(saved).model
    add_lora(model, LoraSettings(rank=2), seed=0)
    save_checkpoint(tmp_path / "tuned", model, example_metadata(lora=LoraSettings(rank=2)), base=saved)
    assert (tmp_path / "tuned" / WEIGHTS).stat().st_size < (saved / WEIGHTS).stat().st_size
    (tmp_path / "moved").mkdir()
    saved.rename(tmp_path / "moved" / "expert")
    (tmp_path / "tuned").rename(tmp_path / "moved" / "tuned")
    back = load_checkpoint(tmp_path / "moved" / "tuned")
    assert torch.equal(back.model(*inputs(SMALL)), small_model()(*inputs(SMALL)))
    assert back.metadata.base == "../expert"


def test_weights_stored_in_bfloat16_are_rounded_and_load_in_the_bases_type(saved, tmp_path):
    model = load_checkpoint(saved).model
    add_lora(model, LoraSettings(rank=2), seed=0)
    torch.nn.init.normal_(model.action_expert.output.weight)
    for folder, dtype in (("whole", None), ("half", torch.bfloat16)):
        metadata = example_metadata(lora=LoraSettings(rank=2))
        save_checkpoint(tmp_path / folder, model, metadata, base=saved, dtype=dtype)
    whole, half = (load_tensors(tmp_path / folder)[0] for folder in ("whole", "half"))
    assert {tensor.dtype for tensor in half.values()} == {torch.float32}
    frozen = load_tensors(saved)[0]
    for name, tensor in whole.items():
        kept = name in frozen and torch.equal(tensor, frozen[name])
        assert torch.equal(half[name], tensor if kept else tensor.bfloat16().float()), name
    stored = load_file(tmp_path / "half" / WEIGHTS)
    assert stored.keys() == load_file(tmp_path / "whole" / WEIGHTS).keys()
    assert {tensor.dtype for tensor in stored.values()} == {torch.bfloat16}


def test_another_base_in_the_bases_place_is_refused(saved, tmp_path):
    save_checkpoint(tmp_path / "tuned", small_model(), example_metadata(), base=saved)
    save_checkpoint(saved, small_model(seed=1), example_metadata())
    refused(tmp_path / "tuned", f"expected tensors of hash .* for '{tmp_path / 'tuned' / '..' / saved.name}")


def test_the_message_for_a_missing_base_names_the_expert(saved, tmp_path):
    save_checkpoint(tmp_path / "tuned", small_model(), example_metadata(), base=saved)
    saved.rename(tmp_path / "moved")
    refused(tmp_path / "tuned", f"'{tmp_path / 'tuned'}': expected its base at '../{saved.name}'")


def test_the_digest_is_of_the_content_and_not_of_the_place_or_the_metrics(saved, tmp_path):
    save_checkpoint(tmp_path / "same", small_model(), example_metadata(metrics={}))
    save_checkpoint(tmp_path / "other", small_model(seed=1), example_metadata())
    save_checkpoint(tmp_path / "scaled", small_model(), example_metadata(statistics=task_statistics(1)))
    digests = [digest_of(str(f)) for f in (saved, tmp_path / "same", tmp_path / "other", tmp_path / "scaled")]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3


@pytest.mark.parametrize("keep", [0, 4, 200, -1])
def test_a_truncated_file_is_refused(saved, keep):
    data = (saved / WEIGHTS).read_bytes()
    (saved / WEIGHTS).write_bytes(data[:keep])
    refused(saved, "truncated")


def test_bytes_after_the_tensors_are_refused_before_loading(saved):
    with (saved / WEIGHTS).open("ab") as file:
        file.write(b"more")
    refused(saved, r"expected \d+ bytes in")
    with pytest.raises(CheckpointError, match=r"expected \d+ bytes in"):
        digest_of(str(saved))


def test_a_file_of_another_format_is_refused_even_with_the_right_hash(saved):
    data = (saved / WEIGHTS).read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = data[8 : 8 + length].replace(b'"F32"', b'"X32"')
    (saved / WEIGHTS).write_bytes(data[:8] + header + data[8 + length :])
    rewrite(saved, tensor_hash=hash_tensors(saved / WEIGHTS))
    refused(saved, "expected a safetensors file in")


def test_a_write_error_is_an_oserror_and_leaves_no_file(tmp_path):
    with full_disk(), pytest.raises(OSError, match="File too large") as caught:
        save_checkpoint(tmp_path, small_model(), example_metadata())
    assert caught.value.errno == errno.EFBIG
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_read_is_named(saved):
    (saved / METADATA_FILE).unlink()
    (saved / METADATA_FILE).mkdir()
    refused(saved, f"'{saved / METADATA_FILE}', got: a folder, no regular file")


def test_a_file_that_never_ends_or_is_empty_space_is_refused_at_once(saved):
    weights, metadata = (saved / WEIGHTS), (saved / METADATA_FILE)
    length = len(json.dumps(header := {"a": {"dtype": "U8", "shape": [10**11], "data_offsets": [0, 10**11]}}))
    weights.write_bytes(length.to_bytes(8, "little") + json.dumps(header).encode())
    os.truncate(weights, 8 + length + 10**11)
    refused(saved, "bytes of holes")
    os.truncate(metadata, 16_000_001)
    refused(saved, "more than 16,000,000 bytes")
    metadata.unlink()
    os.mkfifo(metadata)
    refused(saved, "a named pipe, no regular file")


def test_a_changed_weight_is_refused(saved):
    data = bytearray((saved / WEIGHTS).read_bytes())
    data[-1] ^= 1
    (saved / WEIGHTS).write_bytes(data)
    refused(saved, "expected tensors of hash")
    with pytest.raises(CheckpointError, match="expected tensors of hash"):
        digest_of(str(saved))


def test_a_base_of_another_architecture_is_refused(saved, tmp_path):
    save_checkpoint(tmp_path / "tuned", small_model(), example_metadata(), base=saved)
    rewrite(tmp_path / "tuned", architecture=replace(SMALL, image_size=32).as_json())
    refused(tmp_path / "tuned", "with image_size 32, got 'small' with 16")
    rewrite(tmp_path / "tuned", architecture=replace(SMALL, name="x" * 1_000).as_json())
    refused(tmp_path / "tuned", "expected architecture 'x+ ... x+' with name x+ ... x+, got 'small' with small")


def test_tensors_of_another_architecture_than_in_the_metadata_are_refused(saved):
    rewrite(saved, architecture=replace(SMALL, action_queries=5).as_json())
    refused(saved, r"expected action_queries of shape \(5, 16\) by its metadata, got \(3, 16\)")


def test_nan_weights_are_neither_saved_nor_loaded(saved, monkeypatch):
    model = small_model()
    with torch.no_grad():
        model.action_queries[0, 0] = torch.nan
    with pytest.raises(CheckpointError, match="NaN or infinity in action_queries"):
        save_checkpoint(saved, model, example_metadata())
    monkeypatch.setattr("robogauntlet_mergevla.checkpoints.expert_checkpoint.check_finite", lambda *_: None)
    save_checkpoint(saved, model, example_metadata())
    monkeypatch.undo()
    refused(saved, "NaN or infinity in action_queries")


def test_how_much_of_a_chunk_is_executed_is_part_of_the_digest():
    assert example_metadata(action_steps=2).digest != example_metadata().digest
    assert CheckpointMetadata.from_json(example_metadata(action_steps=2).as_json()).action_steps == 2


@pytest.mark.parametrize("name", ["model.pt", "pytorch_model.bin", "weights.pkl"])
def test_a_pickle_is_refused_and_never_opened(tmp_path, name):
    file = tmp_path / name
    file.write_bytes(pickle.dumps(Exploding()))
    refused(file, f"got {name}, a pickle: refused")
    refused(tmp_path, f"got {name}, a pickle: refused")


def test_a_pickle_named_safetensors_is_refused_and_never_opened(saved):
    (saved / WEIGHTS).write_bytes(pickle.dumps(Exploding()))
    refused(saved, "another format")


def test_a_reference_that_is_neither_folder_nor_hub_id_is_refused(saved):
    refused(Path("/nowhere/at/all"), "a checkpoint's folder or a hub id")
    refused(saved / METADATA_FILE, "a checkpoint's folder or a hub id")


def test_a_hub_id_is_fetched_by_its_revision_with_weights_and_metadata_only(saved, monkeypatch):
    asked = {}

    def fetch(name, **options):
        asked.update(options, name=name)
        return str(saved)

    monkeypatch.setattr("huggingface_hub.snapshot_download", fetch)
    assert locate("owner/name@v1") == saved
    assert asked == {"name": "owner/name", "revision": "v1", "allow_patterns": [WEIGHTS, METADATA_FILE]}


@pytest.mark.parametrize("what", ["base", "expert null/Reach"])
def test_what_a_checkpoint_refers_to_on_the_hub_is_known_to_be_there_where_nothing_is_downloaded(saved, what):
    with without_downloads(), pytest.raises(OnHub, match="'owner/name@v1' would be downloaded from the hub"):
        base_folder(saved, "owner/name@v1", what)


def test_an_unreachable_hub_is_one_line(monkeypatch):
    def fetch(name, **options):
        raise OSError("no route\nto host")

    monkeypatch.setattr("huggingface_hub.snapshot_download", fetch)
    refused("owner/name", "expected a folder or hub id, got 'owner/name', which is no folder: no route")


class Exploding:
    """Fails the test when it is unpickled."""

    def __reduce__(self):
        return pytest.fail, ("a pickle was opened",)
