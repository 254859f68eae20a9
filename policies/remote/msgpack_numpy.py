"""Messages of openpi's protocol: msgpack with numpy arrays, without types that could run code or exhaust memory.

An array is a mapping `{b"__ndarray__": True, b"data": bytes, b"dtype": text, b"shape": [...]}`, a numpy number
`{b"__npgeneric__": True, b"data": number, b"dtype": text}`, as in `openpi_client.msgpack_numpy` (Apache 2.0,
https://github.com/Physical-Intelligence/openpi). In addition, received data are checked before numpy sees them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import msgpack
import numpy as np

from robogauntlet.support.text import visible

KINDS = "biufSU"
"""Kinds of numpy types that are sent: truth values, numbers, text. No objects, structures or complex numbers."""
_DTYPE = re.compile(rf"[<>|=]?[{KINDS}][1-9][0-9]{{0,5}}")
_MOST_AXES = 8


MAX_VALUES = 100_000
"""Largest number of values, keys included, in a message; an array counts as a few."""
MAX_DEPTH = 32
"""Lists and mappings within each other."""
_FIXED = {
    **{0xCA: 4, 0xCB: 8, 0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8, 0xD0: 1, 0xD1: 2, 0xD2: 4, 0xD3: 8},
    **{0xD4: 2, 0xD5: 3, 0xD6: 5, 0xD7: 9, 0xD8: 17},
}
"""First byte of a number or a small extension to the number of bytes that follow."""
_SIZED = {0xC4: 1, 0xC5: 2, 0xC6: 4, 0xC7: 1, 0xC8: 2, 0xC9: 4, 0xD9: 1, 0xDA: 2, 0xDB: 4}
"""First byte of bytes, text or an extension to the number of bytes of its length."""
_COUNTED = {0xDC: (2, 1), 0xDD: (4, 1), 0xDE: (2, 2), 0xDF: (4, 2)}
"""First byte of a list or a mapping to the number of bytes of its length, and its values for each unit of it."""


class PackingError(Exception):
    """Data that are not, or cannot become, a message of this protocol. Its text is one line, whatever they hold."""

    def __init__(self, message: str) -> None:
        super().__init__(visible(message))


def pack(message: Mapping[str, Any]) -> bytes:
    """Return a message as bytes.

    Raises PackingError for an array of objects, structures or complex numbers, or a value that is not plain.
    """
    try:
        packed: bytes = msgpack.packb(message, default=_packed)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise PackingError(f"cannot be sent: {error}") from None
    return packed


def unpack(frame: bytes, read_mapping: Callable[[dict[Any, Any]], Any] | None = None) -> Any:
    """Return the message in a frame. Arrays are new and can be written to.

    `read_mapping` makes a value of each mapping, the innermost first; by default it reads this protocol's arrays.
    Raises PackingError if the frame is not msgpack, has more than MAX_VALUES values or MAX_DEPTH levels, or an array's
    type and shape do not fit its bytes.
    """
    _check_size(frame)
    try:
        return msgpack.unpackb(frame, object_hook=read_mapping or _unpacked, ext_hook=_refuse, strict_map_key=True)
    except PackingError:
        raise
    except msgpack.exceptions.ExtraData as error:
        raise PackingError(f"expected one msgpack message, got {len(error.extra)} bytes more") from None
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise PackingError(f"expected msgpack, got {len(frame)} bytes that are not: {reason}") from None


def array_of(dtype: Any, shape: Any, data: bytes) -> np.ndarray:
    """Return an array that another process describes. Raises PackingError if type and shape do not fit the bytes."""
    return _array({b"dtype": dtype, b"shape": shape, b"data": data})


def nd_message(array: np.ndarray) -> dict[bytes, Any]:
    """Return an array as msgpack-numpy writes it."""
    return {b"nd": True, b"type": array.dtype.str, b"kind": b"", b"shape": array.shape, b"data": array.tobytes()}


def nd_array(value: Any) -> Any:
    """Return an array or number that msgpack-numpy has written; another value unchanged.

    Raises PackingError for objects and structures, and what `array_of` refuses.
    """
    if not isinstance(value, dict) or b"nd" not in value:
        return value
    if value.get(b"kind", b"") != b"":
        raise PackingError("expected an array of numbers, got one of objects or structures")
    return array_of(value.get(b"type"), value.get(b"shape") if value[b"nd"] else [], value.get(b"data", b""))


def _check_size(frame: bytes) -> None:
    """Count a frame's values before any is made: a frame of 16 MiB can announce lists of many gigabytes.

    Raises PackingError if there are too many, or they are nested too deeply. What is cut short is left to msgpack.
    """
    at, seen, levels = 0, 1, [1]
    while at < len(frame) and levels:
        levels[-1] -= 1
        first, at = frame[at], at + 1
        values = 0
        if first in _COUNTED:
            size, unit = _COUNTED[first]
            values, at = unit * int.from_bytes(frame[at : at + size]), at + size
        elif 0x80 <= first <= 0x9F:
            values = (first & 15) * (2 if first < 0x90 else 1)
        elif first in _SIZED:
            size = _SIZED[first]
            at += size + int.from_bytes(frame[at : at + size]) + (0xC7 <= first <= 0xC9)
        else:
            at += first & 31 if 0xA0 <= first <= 0xBF else _FIXED.get(first, 0)
        seen += values
        if seen > MAX_VALUES:
            raise PackingError(f"expected a message of {MAX_VALUES} values at most, got more")
        if values:
            levels.append(values)
            if len(levels) > MAX_DEPTH:
                raise PackingError(f"expected {MAX_DEPTH} levels of lists and mappings at most, got more")
        while levels and not levels[-1]:
            levels.pop()


def _packed(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind not in KINDS:
            raise TypeError(f"expected numbers or text, got an array of type {value.dtype}")
        if isinstance(value, np.ndarray):
            array = np.ascontiguousarray(value)
            # The view saves a copy of each image; empty arrays and text have none.
            data = array.reshape(-1).view(np.uint8).data if array.size and array.dtype.kind != "U" else array.tobytes()
            return {b"__ndarray__": True, b"data": data, b"dtype": array.dtype.str, b"shape": value.shape}
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"expected numbers, text, lists, mappings and arrays, got {type(value).__name__}")


def _unpacked(value: dict[Any, Any]) -> Any:
    if b"__ndarray__" in value:
        return _array(value)
    if b"__npgeneric__" in value:
        dtype, data = _dtype(value), value.get(b"data")
        if not isinstance(data, bool | int | float | str | bytes):
            raise PackingError(f"expected a number of type {dtype}, got {type(data).__name__}")
        try:
            return dtype.type(data)
        except (ValueError, TypeError, OverflowError):
            raise PackingError(f"expected a number of type {dtype}, got another") from None
    return value


def _array(value: dict[Any, Any]) -> np.ndarray:
    dtype, data, shape = _dtype(value), value.get(b"data"), value.get(b"shape")
    sound = isinstance(shape, list) and all(type(length) is int and length >= 0 for length in shape)
    if not sound or not isinstance(data, bytes) or len(shape or ()) > _MOST_AXES:
        raise PackingError(f"expected an array's bytes and shape of {_MOST_AXES} axes at most, got something else")
    if math.prod(shape) * dtype.itemsize != len(data):  # type: ignore[arg-type]
        raise PackingError(f"expected an array of type {dtype} and shape {tuple(shape)}, got {len(data)} bytes")  # type: ignore[arg-type]
    try:
        return np.frombuffer(data, dtype).reshape(shape).copy() if data else np.zeros(shape, dtype)  # type: ignore[arg-type]
    except (ValueError, OverflowError):
        raise PackingError("expected an array's shape, got lengths that numpy does not take") from None


def _dtype(value: dict[Any, Any]) -> np.dtype:
    name = value.get(b"dtype")
    if not isinstance(name, str) or not _DTYPE.fullmatch(name):
        raise PackingError(f"expected an array of numbers or text, got type {str(name)[:40]!r}")
    try:
        return np.dtype(name)
    except TypeError:
        raise PackingError(f"expected an array of numbers or text, got type {name!r}") from None


def _refuse(code: int, data: bytes) -> Any:
    raise PackingError(f"expected plain msgpack, got extension type {code}")
