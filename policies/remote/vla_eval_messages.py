"""Messages of vla-evaluation-harness' protocol, which client and server share.

The protocol is that of https://github.com/allenai/vla-evaluation-harness (`vla_eval.protocol`, Apache 2.0), version 1:
messages `{type, payload, seq, timestamp}` as msgpack. The client says hello, and the server answers with what it takes
and gives; an episode starts without an answer; each observation is answered with one action, of the same `seq`. The
server keeps the chunk of an episode, and a connection has one episode at a time.
"""

from __future__ import annotations

import io
import time
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import numpy as np
from PIL import Image as Picture

from robogauntlet.policies.remote.msgpack_numpy import PackingError, array_of, pack
from robogauntlet.policies.remote.protocol import MAX_IMAGE_SIZE

VERSION = 1
ARRAY, IMAGE = "__ndarray__", "__image__"
"""Keys of mappings that stand for an array, and for a compressed image."""
COMPRESSIONS = ("PNG", "JPEG")


class Kind(StrEnum):
    """What a message is."""

    HELLO = "hello"
    EPISODE_START = "episode_start"
    OBSERVATION = "observation"
    ACTION = "action"
    EPISODE_END = "episode_end"
    ERROR = "error"


def message_of(kind: Kind, payload: Mapping[str, Any], number: int) -> dict[str, Any]:
    """Return a message of this `seq`."""
    return {"type": kind.value, "payload": _sent(payload), "seq": number, "timestamp": time.time()}


def hello_frame(number: int = 0, **said: Any) -> bytes:
    """Return the first message of either side; `said` is what a server says of itself."""
    return pack(message_of(Kind.HELLO, {"harness_version": "", "protocol_version": VERSION, **said}, number))


def check_version(payload: Mapping[str, Any], who: str) -> None:
    """Check the version of a hello. Raises PackingError for another than `VERSION`; `who` sent it."""
    version = payload.get("protocol_version")
    if type(version) is not int or version != VERSION:
        raise PackingError(f"expected a {who} of protocol version {VERSION}, got version {str(version)[:20]}")


def _sent(value: Any) -> Any:
    """Return a payload with arrays as the protocol describes them, images without compression."""
    if isinstance(value, np.ndarray):
        return {ARRAY: True, "data": value.tobytes(), "dtype": value.dtype.str, "shape": list(value.shape)}
    return {key: _sent(item) for key, item in value.items()} if isinstance(value, Mapping) else value


def received(value: Any) -> Any:
    """Return a value of a payload, as an array if it stands for one. Raises PackingError if it is not one."""
    if not isinstance(value, dict) or not (value.get(ARRAY) or value.get(IMAGE)):
        return value
    if value.get(IMAGE) and value.get("format") != "raw":
        return _decompressed(value.get("data"))
    return array_of(value.get("dtype"), value.get("shape"), value.get("data", b""))


def _decompressed(data: Any) -> np.ndarray:
    if not isinstance(data, bytes):
        raise PackingError(f"expected an image's bytes, got {type(data).__name__}")
    try:
        with Picture.open(io.BytesIO(data), formats=COMPRESSIONS) as picture:
            if max(picture.size) > MAX_IMAGE_SIZE:  # some bytes can announce gigabytes
                width, height = picture.size
                raise PackingError(f"expected images of {MAX_IMAGE_SIZE} px at most, got {height} x {width}")
            return np.array(picture)
    except PackingError:
        raise
    except Exception:  # what a damaged file raises is its format's own matter
        raise PackingError(
            f"expected an image as {' or '.join(COMPRESSIONS)}, got {len(data)} bytes that are none"
        ) from None
