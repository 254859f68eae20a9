"""Encoding of episodes in the LeRobot layout."""

import json

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as arrays

from robogauntlet.adapters.contract import Body
from robogauntlet.policies.training.lerobot_format import (
    DatasetError,
    decode_png,
    encode_episode,
    encode_png,
    episode_table,
    features,
    number_statistics,
    pooled_image_statistics,
    spec_of,
)
from tests.policies.training.synthetic import recording


@given(arrays.arrays(np.uint8, (8, 8, 3)))
def test_images_are_stored_without_loss(image):
    assert np.array_equal(decode_png(encode_png(image)), image)


def test_an_image_that_is_no_png_is_refused():
    with pytest.raises(DatasetError, match="expected a PNG image, got 5 bytes of another format"):
        decode_png(b"GIF89")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"states": np.zeros((12, 7))}, r"states: expected shape \(12, 8\), got \(12, 7\)"),
        ({"actions": np.zeros((12, 6))}, r"actions: expected shape \(12, 7\), got \(12, 6\)"),
        ({"actions": np.full((12, 7), np.nan)}, "expected finite states and actions, got NaN or infinity"),
        ({"control_hz": 12.5}, "expected a whole number of control steps per second, got 12.5"),
        ({"images": {}}, "expected at least one step and one camera, got 12 and 0"),
        ({"images": {"wrist": [np.zeros((16, 16, 3), np.uint8)] * 11}}, r"images of wrist: expected shape \(12, 16"),
    ],
)
def test_a_recording_that_does_not_fit_is_refused(changes, message):
    with pytest.raises(DatasetError, match=message):
        encode_episode(recording(**changes))


def test_equal_recordings_have_equal_hashes():
    assert encode_episode(recording(3)).content_hash == encode_episode(recording(3)).content_hash


@pytest.mark.parametrize("what", ["states", "actions", "success", "images", "instruction", "control_hz", "cameras"])
def test_the_hash_changes_with_every_value(what):
    base = recording()
    changed = {
        "states": {"states": base.states + 1e-6},
        "actions": {"actions": base.actions * (1.0 + 1e-6)},
        "success": {"success": ~base.success},
        "images": {"images": {**base.images, "wrist": [base.images["wrist"][0] ^ 1, *base.images["wrist"][1:]]}},
        "instruction": {"instruction": "reach the other goal"},
        "control_hz": {"control_hz": 25.0},
        "cameras": {"images": {"wrist": base.images["third_person"], "third_person": base.images["wrist"]}},
    }[what]
    assert encode_episode(recording(**changed)).content_hash != encode_episode(base).content_hash


def test_the_columns_are_those_that_lerobot_expects():
    episode = encode_episode(recording())
    table = episode_table(episode, episode_index=4, first_index=100, task_index=2)
    assert table.schema.field("action").type == pa.list_(pa.float32(), 7)
    assert table.schema.field("observation.state").type == pa.list_(pa.float32(), 8)
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    assert table.schema.field("observation.images.wrist").type == image
    assert table["index"].to_pylist() == list(range(100, 112))
    assert table["frame_index"].to_pylist() == list(range(12))
    assert set(table["episode_index"].to_pylist()) == {4}
    assert table["timestamp"].to_numpy() == pytest.approx(np.arange(12) / 20)
    hints = json.loads(table.schema.metadata[b"huggingface"])["info"]["features"]
    assert hints["observation.images.wrist"] == {"_type": "Image"}
    assert hints["action"]["length"] == 7


def test_the_columns_of_two_arms_name_the_numbers_of_each():
    episode = encode_episode(recording(states=np.zeros((12, 16)), actions=np.zeros((12, 14)), body=Body(2)))
    columns = features(episode.spec)
    assert columns["action"]["shape"] == [14]
    assert columns["action"]["names"][6:8] == ["gripper", "second_dx"]
    assert columns["observation.state"]["names"][7:9] == ["finger_right", "second_x"]
    assert spec_of({"fps": 20, "features": columns}) == episode.spec


@given(arrays.arrays(np.float32, (20, 3), elements=st.floats(-5, 5, width=32)))
def test_statistics_are_equal_to_numpys(values):
    found = number_statistics(values)
    wide = values.astype(np.float64)
    assert np.allclose(found["mean"], wide.mean(0))
    assert np.allclose(found["std"], wide.std(0))
    assert np.allclose(found["q01"], np.quantile(wide, 0.01, axis=0))
    assert np.allclose(found["q99"], np.quantile(wide, 0.99, axis=0))
    assert (found["min"], found["max"]) == (wide.min(0).tolist(), wide.max(0).tolist())
    assert found["count"] == [20]


def test_pooled_image_statistics_are_those_of_all_images_together():
    recordings = [recording(seed, steps) for seed, steps in enumerate((3, 9, 20))]
    parts = [encode_episode(r).image_statistics["wrist"] for r in recordings]
    found = pooled_image_statistics(parts)
    pixels = np.concatenate([np.stack(r.images["wrist"]) for r in recordings]) / 255.0
    assert np.allclose(np.ravel(found["mean"]), pixels.mean((0, 1, 2)))
    assert np.allclose(np.ravel(found["std"]), pixels.std((0, 1, 2)))
    assert np.allclose(np.ravel(found["max"]), pixels.max((0, 1, 2)))
    assert np.shape(found["mean"]) == (3, 1, 1)
    assert found["count"] == [32]
