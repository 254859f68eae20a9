"""The header of a safetensors file is checked against the file before any tensor is read."""

import io
import json

import pytest

from robogauntlet_mergevla.checkpoints.tensor_file import StoredTensor, TensorFileError, read_header
from tests.errors import one_line_error


def stored(header, tensors=b""):
    text = json.dumps(header).encode() if not isinstance(header, bytes) else header
    return len(text).to_bytes(8, "little") + text + tensors


def entry(first, last, shape, dtype="F32"):
    return {"dtype": dtype, "shape": shape, "data_offsets": [first, last]}


def test_a_sound_file_says_where_its_tensors_are():
    content = stored({"__metadata__": {"format": "pt"}, "b": entry(8, 20, [3]), "a": entry(0, 8, [1, 2])}, bytes(20))
    start = len(content) - 20
    read = read_header(io.BytesIO(content), len(content))
    assert read == {"a": StoredTensor("F32", [1, 2], start, 8), "b": StoredTensor("F32", [3], start + 8, 12)}


UNSOUND = {
    "a shape of more numbers": (stored({"a": entry(0, 8, [2**40])}, bytes(8)), "got 8 bytes for a, of type F32"),
    "a type of fewer bytes": (stored({"a": entry(0, 8, [2], "F16")}, bytes(8)), "got 8 bytes for a, of type F16"),
    "one place for two": (stored({"a": entry(0, 8, [2]), "b": entry(0, 8, [2])}, bytes(8)), "got b at byte"),
    "a gap": (stored({"a": entry(4, 8, [1])}, bytes(8)), "got a at byte"),
    "less than it says": (stored({"a": entry(0, 8, [2])}, bytes(7)), "it is truncated"),
    "terabytes that are not there": (stored({"a": entry(0, 2**42, [2**40])}, b""), "it is truncated"),
    "more than it says": (stored({"a": entry(0, 8, [2])}, bytes(9)), "something follows its tensors"),
    "offsets backwards": (stored({"a": entry(8, 0, [2])}, bytes(8)), "another format"),
    "a negative shape": (stored({"a": entry(0, 8, [-2])}, bytes(8)), "another format"),
    "an infinite shape": (stored(b'{"a": {"dtype": "F32", "shape": [Infinity], "data_offsets": [0, 8]}}'), "another"),
    "three offsets": (stored({"a": {**entry(0, 8, [2]), "data_offsets": [0, 4, 8]}}, bytes(8)), "another format"),
    "a list": (stored([]), "another format"),
    "lists in lists": (stored(b"[" * 100_000), "another format"),
    "a header beyond the file": ((2**40).to_bytes(8, "little"), "another format"),
    "nothing": (b"", "another format"),
}


@pytest.mark.parametrize(("content", "match"), UNSOUND.values(), ids=UNSOUND)
def test_a_file_that_is_not_as_its_header_says_is_one_line(content, match):
    with one_line_error(TensorFileError, match):
        read_header(io.BytesIO(content), len(content))
