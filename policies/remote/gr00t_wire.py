"""Messages and the connection of GR00T's policy server: msgpack over ZeroMQ, one question and one answer at a time.

The format is that of https://github.com/NVIDIA/Isaac-GR00T (`gr00t/policy/server_client.py`, Apache 2.0), N1.6 and
newer. An array is `{"__ndarray_class__": true, "as_npy": bytes of an .npy file}`, or from newer servers what
msgpack-numpy writes, `{b"nd": true, b"type": ..., b"kind": b"", b"shape": ..., b"data": ...}`; both read the first. A
question is `{"endpoint": name, "data": arguments, "api_token": token}`, an error `{"error": text}`.
"""

from __future__ import annotations

import io
import re
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np

from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.remote.connection import (
    MAX_FRAME_BYTES,
    MAX_GREETING_BYTES,
    Lost,
    ServerConnection,
    error_text,
    no_connection,
    packed,
)
from robogauntlet.policies.remote.msgpack_numpy import PackingError, array_of, nd_array, unpack
from robogauntlet.policies.remote.server_options import ServerOptions
from robogauntlet.support.json_text import parse_json

if TYPE_CHECKING:
    import zmq

EXPECTED = "a policy server of GR00T N1.6 or newer"
CONFIGS = ("__ModalityConfig__", "__ModalityConfig_class__")
"""Keys that mark a modality's configuration, from newer and older servers."""
HINTS = {
    "Unauthorized": "; give its token by option token_variable",
    "'video.": "; start it without --use-sim-policy-wrapper",
}
"""Part of a server's error to what to do."""
_NPY = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '([<|][biuf][1248])', 'fortran_order': (False|True), "
    rb"'shape': \(([0-9, ]{0,100})\), \} *\n",
    re.DOTALL,
)
"""The header of an .npy file of numbers, as numpy writes it."""
_SIGNATURE = 10
"""Bytes with which a ZeroMQ socket greets: 255, eight bytes, 127."""


def array_message(array: np.ndarray) -> dict[str, Any]:
    """Return an array as the protocol sends it."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return {"__ndarray_class__": True, "as_npy": file.getvalue()}


def read_message(frame: bytes) -> Any:
    """Return the message in a frame, with arrays of numbers. Raises PackingError for what is none, such as a pickle."""
    if frame == b"ERROR" or frame[:2] == b"PK" or re.match(rb"\x80[\x02-\x05]", frame):
        raise PackingError("got what servers of N1.5 send, which speak pickles: these are never read; serve by N1.6")
    return unpack(frame, _read_mapping)


def _read_mapping(value: dict[Any, Any]) -> Any:
    if "__ndarray_class__" in value:
        return _npy_array(value.get("as_npy"))
    if b"nd" in value:
        return nd_array(value)
    if any(marker in value for marker in CONFIGS) and isinstance(value.get("as_json"), str):
        try:
            return value | {"as_json": parse_json(value["as_json"])}
        except ValueError:
            raise PackingError("expected a modality's configuration as JSON, got text that is none") from None
    return value


def _npy_array(data: Any) -> np.ndarray:
    """Return the array in the bytes of an .npy file, whose header is read without numpy, which may allocate by it."""
    header = _NPY.match(data) if isinstance(data, bytes) else None
    if header is None:
        raise PackingError("expected an array of numbers as an .npy file of version 1, got something else")
    dtype, numbers = header[1].decode(), data[header.end() :]
    shape = [int(length) for length in header[3].split(b",") if length.strip()]
    if header[2] == b"True":  # in the order of Fortran, the first index fastest
        return array_of(dtype, shape[::-1], numbers).T
    return array_of(dtype, shape, numbers)


class Gr00tConnection(ServerConnection):
    """A ZeroMQ socket to one server."""

    def __init__(self, options: ServerOptions, accept: Callable[[Any], None]) -> None:
        """`accept` is called with the modalities of a server. Raises PolicyError for a server that is refused."""
        import zmq

        super().__init__(options)
        self._zmq, self._accept = zmq, accept
        self._socket: zmq.Socket[bytes] | None = None
        self._monitor: zmq.Socket[bytes]
        """Tells that the connection was lost."""

    def question(self, endpoint: str, data: Mapping[str, Any] | None = None) -> bytes:
        """Return the frame that calls an endpoint. Raises PolicyError if it cannot be sent."""
        token = self._token()
        message = {"endpoint": endpoint} | ({} if data is None else {"data": data})
        return packed(message if token is None else message | {"api_token": token})

    def close(self) -> None:
        """Close the socket, and with it a late answer. The next question connects again."""
        socket, self._socket = self._socket, None
        if socket is not None:
            socket.disable_monitor()
            for one in (self._monitor, socket):
                one.close(linger=0)

    @property
    def _is_open(self) -> bool:
        return self._socket is not None

    def _open(self, seconds: float) -> None:
        zmq, deadline = self._zmq, time.monotonic() + seconds
        self._check_port(deadline)
        self._socket = asked = zmq.Context.instance().socket(zmq.REQ)
        for option, value in ((zmq.LINGER, 0), (zmq.MAXMSGSIZE, MAX_FRAME_BYTES), (zmq.IPV6, 1)):
            asked.setsockopt(option, value)
        self._monitor = asked.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        asked.connect(self._options.address.replace("gr00t://", "tcp://", 1))
        late = f"expected {EXPECTED}, got nothing in time; is it another kind of server?"
        self._read(self._answer(self.question("ping"), deadline, late))
        frame = self._answer(self.question("get_modality_config"), deadline, late)
        if len(frame) > MAX_GREETING_BYTES:
            limit = f"{MAX_GREETING_BYTES >> 20} MiB"
            raise PolicyError(f"{self._server}: expected modalities of at most {limit}, got {len(frame)} bytes")
        self._accept(self._read(frame))

    def _exchange(self, frames: Sequence[bytes], deadline: float) -> Any:
        (question,) = frames
        return self._read(self._answer(question, deadline, None))

    def _check_port(self, deadline: float) -> None:
        """Raise Lost if nothing listens, which ZeroMQ does not tell, and PolicyError for what is no ZeroMQ socket."""
        address, left = urlsplit(self._options.address), max(0.01, deadline - time.monotonic())
        try:
            probe = socket.create_connection((address.hostname, address.port), left)
        except (OSError, UnicodeError) as error:
            raise Lost(no_connection(error)) from None
        with probe:
            try:
                probe.settimeout(max(0.01, deadline - time.monotonic()))
                greeting = probe.recv(_SIGNATURE)
            except TimeoutError:
                greeting = b""
            except OSError as error:
                raise Lost(no_connection(error)) from None
        if len(greeting) < _SIGNATURE or greeting[0] != 255 or greeting[-1] != 127:
            raise PolicyError(
                f"{self._server}: expected {EXPECTED}, got no greeting of ZeroMQ; is it another kind of server?"
            )

    def _answer(self, question: bytes, deadline: float, late: str | None) -> bytes:
        """Return the frame that answers a question. Raises PolicyError, with the message `late` if there is none."""
        zmq, asked = self._zmq, self._socket
        assert asked is not None
        asked.send(question)
        poller = zmq.Poller()
        for one in (asked, self._monitor):
            poller.register(one, zmq.POLLIN)
        ready = dict(poller.poll(1000 * max(0.0, deadline - time.monotonic())))
        if asked in ready:
            return b"".join(asked.recv_multipart())
        if self._monitor in ready:
            raise Lost(f"it closed the connection, or began an answer of more than {MAX_FRAME_BYTES >> 20} MiB")
        raise self._late() if late is None else PolicyError(f"{self._server}: {late}")

    def _read(self, frame: bytes) -> Any:
        try:
            message = read_message(frame)
        except PackingError as error:
            raise PolicyError(f"{self._server}: expected {EXPECTED}: {error}") from None
        if isinstance(message, dict) and "error" in message:
            said = error_text(message["error"])
            hint = next((hint for sign, hint in HINTS.items() if sign in said), "")
            raise PolicyError(f"{self._server}: expected an answer, got an error: {said}{hint}")
        return message
