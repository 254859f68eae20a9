"""msgpack with numpy arrays: messages are read back, and other data are refused."""

import contextlib
import tracemalloc

import msgpack
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as arrays

from robogauntlet.policies.remote.msgpack_numpy import PackingError, pack, unpack

TYPES = st.one_of(
    arrays.boolean_dtypes(),
    arrays.integer_dtypes(endianness="?"),
    arrays.unsigned_integer_dtypes(endianness="?"),
    arrays.floating_dtypes(sizes=(16, 32, 64), endianness="?"),
    arrays.unicode_string_dtypes(max_len=5),
)
ARRAYS = arrays.arrays(TYPES, arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4))
PLAIN = st.one_of(st.none(), st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(allow_nan=False), st.text())
VALUES = st.recursive(
    PLAIN | ARRAYS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3)
)


def same(sent, received):
    if isinstance(sent, dict):
        return list(sent) == list(received) and all(same(sent[key], received[key]) for key in sent)
    if isinstance(sent, list):
        return len(sent) == len(received) and all(map(same, sent, received))
    if isinstance(sent, np.ndarray):
        ours, theirs = ((one.dtype.str, one.shape, one.tobytes()) for one in (sent, received))
        return ours == theirs
    return type(sent) is type(received) and sent == received


@given(st.dictionaries(st.text(), VALUES, max_size=4))
def test_a_packed_message_unpacks_bit_identical(message):
    assert same(message, unpack(pack(message)))


def test_slices_and_numpy_numbers_are_unpacked_writable():
    image = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)[::-1, ::2]
    found = unpack(pack({"image": image, "one": np.float32(1.5)}))
    np.testing.assert_array_equal(found["image"], image)
    found["image"][0] = 0
    assert (found["one"], found["one"].dtype) == (1.5, np.float32)


@pytest.mark.parametrize("value", [np.array([object()]), np.zeros(2, "i4,f4"), np.zeros(2, complex), object(), 2**70])
def test_values_that_are_not_plain_are_refused(value):
    with pytest.raises(PackingError, match=r"^cannot be sent: [^\n]*$"):
        pack({"value": value})


def array(dtype="<f4", data=b"\0" * 8, shape=(2,), **more):
    return msgpack.packb({b"__ndarray__": True, b"dtype": dtype, b"data": data, b"shape": shape, **more})


BAD = {
    "objects": array("|O", b"\0" * 16),
    "structures": array("V8", b"\0" * 16),
    "fields": array("i4,O", b"\0" * 16),
    "complex": array("<c8", b"\0" * 16),
    "times": array("<M8[s]", b"\0" * 16),
    "no type": array(None),
    "empty text": array("<U0", b"", (2**40,)),
    "endless type": array("<f" + "9" * 5),
    "fewer bytes": array(data=b"\0" * 4),
    "more bytes": array(data=b"\0" * 12),
    "negative": array(shape=(-2,)),
    "huge": array(shape=(2**62, 2**62)),
    "huge and empty": array(data=b"", shape=(0, 2**63)),
    "many axes": array(shape=(1,) * 40 + (2,)),
    "real shape": array(shape=(2.0,)),
    "true": array(shape=(True, 2)),
    "text for bytes": array(data="\0" * 8),
    "number of objects": msgpack.packb({b"__npgeneric__": True, b"dtype": "|O", b"data": 1}),
    "number of lists": msgpack.packb({b"__npgeneric__": True, b"dtype": "<f4", b"data": [1]}),
    "number too big": msgpack.packb({b"__npgeneric__": True, b"dtype": "|u1", b"data": "x"}),
    "extension": msgpack.packb(msgpack.ExtType(5, b"os.system")),
    "key": msgpack.packb({1: 2}),
    "nothing": b"",
    "text": b"GET / HTTP/1.1",
    "pickle": b"\x80\x04\x95\x1d\x00\x00\x00",
    "cut": pack({"a": np.zeros(100)})[:50],
    "deep": b"\x91" * 5000 + b"\x90",
    "deep mappings": b"\x81\xa1a" * 500 + b"\xc0",
    "too many keys": msgpack.packb({str(number): None for number in range(200_000)}),
    "too many lists": msgpack.packb({"a": [[]] * 200_000}),
    "announced": b"\x81\xa1a\xdd\xff\xff\xff\xff" + b"\xc0" * 2_000_000,
    "announced, nested": b"\xdd\x00\x0f\xff\xff" * 400_000,
    "long text announced": b"\xdb\xff\xff\xff\xff",
}


@pytest.mark.parametrize("frame", BAD.values(), ids=BAD)
def test_a_frame_that_is_no_message_is_refused_in_one_line(frame):
    with pytest.raises(PackingError, match=r"^expected [^\n]*$"):
        unpack(frame)


@pytest.mark.parametrize("frame", BAD.values(), ids=BAD)
def test_a_frame_that_is_no_message_costs_little_memory(frame):
    tracemalloc.start()
    try:
        with contextlib.suppress(PackingError):
            unpack(frame)
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


@given(VALUES)
def test_a_message_within_the_bounds_is_read_however_it_is_nested(value):
    assert same({"a": value}, unpack(pack({"a": value})))


@given(st.binary(max_size=64))
def test_any_bytes_are_read_or_refused(frame):
    with contextlib.suppress(PackingError):
        unpack(frame)
