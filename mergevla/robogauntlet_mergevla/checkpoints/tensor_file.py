"""What a safetensors file says of its tensors, checked before any of them is read. Without torch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO

from robogauntlet.policies.stored import StoredError
from robogauntlet.support.files import LARGEST_DOCUMENT
from robogauntlet.support.json_text import parse_json, whole_number

BITS: Mapping[str, int] = {
    **dict.fromkeys(("F4",), 4),
    **dict.fromkeys(("F6_E2M3", "F6_E3M2"), 6),
    **dict.fromkeys(("BOOL", "U8", "I8", "F8_E5M2", "F8_E4M3", "F8_E8M0", "F8_E5M2FNUZ", "F8_E4M3FNUZ"), 8),
    **dict.fromkeys(("U16", "I16", "F16", "BF16"), 16),
    **dict.fromkeys(("U32", "I32", "F32"), 32),
    **dict.fromkeys(("U64", "I64", "F64", "C64"), 64),
}
"""Bits of a number, by the format's names of types."""
LARGEST_HEADER = LARGEST_DOCUMENT
"""Bytes; a name and a shape for a hundred thousand tensors."""
LARGEST_FILE = 2**63 - 1


class TensorFileError(StoredError):
    """A file that is no sound safetensors file; the message follows the file's name."""


@dataclass(frozen=True)
class StoredTensor:
    """Where a tensor is in its file."""

    dtype: str
    shape: list[int]
    start: int
    """Byte of the file at which it begins."""
    size: int
    """Bytes."""


def read_header(file: BinaryIO, size: int) -> dict[str, StoredTensor]:
    """Return the tensors of an open safetensors file of `size` bytes by name, from its header alone.

    Raises TensorFileError unless the tensors fill the file one after another, each as long as its type and shape say.
    """
    length = int.from_bytes(file.read(8), "little")
    text = file.read(length) if length <= min(LARGEST_HEADER, size) else b""
    try:
        header = parse_json(text)
        header.pop("__metadata__", None)
        tensors = {name: _stored(entry, 8 + length) for name, entry in header.items()}
    except (AttributeError, KeyError, TypeError, ValueError):
        raise TensorFileError("got a truncated one or another format") from None
    end = 8 + length
    for name, tensor in sorted(tensors.items(), key=lambda item: (item[1].start, item[1].size)):
        bits = BITS.get(tensor.dtype)
        if bits is not None and math.prod(tensor.shape) * bits != tensor.size * 8:
            raise TensorFileError(f"got {tensor.size:,} bytes for {name}, of type {tensor.dtype} and {tensor.shape}")
        if tensor.start != end:
            raise TensorFileError(f"got {name} at byte {tensor.start:,}, expected it at {end:,}")
        end += tensor.size
    if end > size:
        raise TensorFileError(f"got {size} bytes, expected {end}: it is truncated")
    if end < size:
        raise TensorFileError(f"got {size} bytes, expected {end} bytes in it: something follows its tensors")
    return tensors


def _stored(entry: Any, offset: int) -> StoredTensor:
    dtype, shape, (first, last) = entry["dtype"], entry["shape"], entry["data_offsets"]
    if not isinstance(dtype, str) or not isinstance(shape, list):
        raise ValueError("a tensor without type or shape")
    first = whole_number(first, 0, LARGEST_FILE)
    size = whole_number(last, first, LARGEST_FILE) - first
    return StoredTensor(dtype, [whole_number(number, 0, LARGEST_FILE) for number in shape], offset + first, size)
