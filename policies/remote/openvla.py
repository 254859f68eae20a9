"""A policy behind the HTTP server of OpenVLA or OpenVLA-OFT.

The contract is that of `vla-scripts/deploy.py` in https://github.com/openvla/openvla and
https://github.com/moojink/openvla-oft (MIT): an observation is posted as JSON, in which an array is
`{"__numpy__": base64, "dtype": ..., "shape": ...}` as json-numpy writes it, and the answer is an action, or a list of
actions. In the form `{"encoded": text}` the observation is JSON within JSON, and so is the answer. It says "error" for
every fault. The server says nothing of itself.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar
from urllib.parse import urlsplit

import numpy as np
from pydantic import Field

from robogauntlet.adapters.contract import Image
from robogauntlet.policies.contract import Decision, PolicyError, PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote.connection import Lost, ServerConnection, error_text, no_connection
from robogauntlet.policies.remote.conversion import MAX_ACTIONS, decode_chunk, encode_observation, images_in
from robogauntlet.policies.remote.msgpack_numpy import MAX_DEPTH, PackingError, array_of
from robogauntlet.policies.remote.remote_policy import RemotePolicy
from robogauntlet.policies.remote.server_options import ChunkKeys, Key, ServerOptions, StateKeys
from robogauntlet.support.json_text import parse_json

MAX_ANSWER_BYTES = 2**20
"""Largest answer: 1,000 actions of eight numbers as text have less."""
EXPECTED = "a server of OpenVLA"
BUSY = (429, 502, 503, 504)
"""HTTP status codes after which the question is asked again."""


class OpenVlaOptions(ServerOptions):
    """The options of the kind `openvla`. The defaults are OpenVLA's."""

    PROTOCOL: ClassVar[str] = "openvla"
    FORM: ClassVar[str] = "openvla+http://HOST:PORT/act"
    SCHEMES: ClassVar[Mapping[str, str]] = {
        **{"http": "http", "https": "https"},
        **{"openvla+http": "http", "openvla+https": "https"},
    }
    PATH: ClassVar[str | None] = "/act"
    ASKS_UNITS: ClassVar[bool] = True
    TRANSPORT: ClassVar[tuple[str, ...]] = (*ServerOptions.TRANSPORT, "encoded")

    address: str
    """openvla+http://HOST:PORT/act, or openvla+https://"""
    cameras: dict[str, Key] = Field(default={"third_person": "image"})
    """camera to its key; OpenVLA-OFT's are {third_person: full_image, wrist: wrist_image}"""
    proprioception: StateKeys = None
    """key of the eight numbers, or of joints and gripper, or several keys with columns; OpenVLA-OFT's is state"""
    instruction: Key | None = "instruction"
    """key of the goal in words"""
    actions: ChunkKeys = "action"
    """key of the chunk, if the answer is a mapping"""
    unnorm_key: Key | None = None
    """name of the data whose statistics scale the answer, for models of several"""
    encoded: bool = False
    """whether the observation is sent as JSON within JSON, for servers that take no other"""


class OpenVlaPolicy(RemotePolicy):
    """Asks a server of OpenVLA, one query at a time. Deterministic if the server is."""

    _options: OpenVlaOptions

    def __init__(self, options: OpenVlaOptions) -> None:
        """Connect, unless `options.identity` names the policy. Raises PolicyMismatch if options say no units."""
        if missing := options.unsaid():
            raise PolicyMismatch(
                f"policy '{options.PROTOCOL}': its servers do not say {', '.join(missing)}; give each by an option, "
                "or all by option convention"
            )
        super().__init__(options)
        execute, cameras = options.execute or MAX_ACTIONS, tuple(options.cameras)
        self.spec = PolicySpec(PolicyInput.OBSERVATION, execute, options.action_dim, cameras, moves=options.moves)

    def images_sent(self, query: Query) -> Mapping[str, Image]:
        """Return the images of a query as the server gets them, by its keys."""
        return images_in(self._message(query))

    def _new_connection(self) -> HttpConnection:
        return HttpConnection(self._options)

    def _decide(self, query: Query) -> Decision:
        answer = self._connection.ask(lambda: [self._posted(query)])
        try:
            return Decision(decode_chunk(self._options, self._chunk(answer), query.action_dim))
        except (PackingError, PolicyMismatch) as error:
            raise PolicyMismatch(f"{self._server}: {error}") from None

    def _message(self, query: Query) -> dict[str, Any]:
        assert query.observation is not None
        return encode_observation(self._options, query.observation, query.episode)

    def _posted(self, query: Query) -> bytes:
        message = self._message(query)
        if self._options.unnorm_key is not None:
            message["unnorm_key"] = self._options.unnorm_key
        text = json.dumps(message, default=_array_as_json)
        return (json.dumps({"encoded": text}) if self._options.encoded else text).encode()

    def _chunk(self, answer: Any) -> dict[str, Any]:
        """Return an answer as a mapping with a chunk. Raises PackingError or PolicyError for the server's "error"."""
        if isinstance(answer, str) and answer != "error":  # JSON within JSON
            answer = _parsed(answer.encode())
        if isinstance(answer, str):
            raise PolicyError(
                f"{self._server}: expected an action, got '{error_text(answer)}'; its log says why; "
                "see options cameras, proprioception and unnorm_key"
            )
        return as_rows(answer, self._options.actions)


class HttpConnection(ServerConnection):
    """Asks a server by HTTP, each time over a connection of its own, and never follows it elsewhere."""

    def __init__(self, options: ServerOptions) -> None:
        super().__init__(options)
        self._found = False

    def close(self) -> None:
        """Look for the server again before the next question."""
        self._found = False

    @property
    def _is_open(self) -> bool:
        return self._found

    def _open(self, seconds: float) -> None:
        late = PolicyError(f"{self._server}: expected {EXPECTED}, got nothing in time; is it another kind of server?")
        status, _ = self._request("GET", None, time.monotonic() + seconds, late)
        self._check(status)  # a server that only takes posts says 405, or 501
        self._found = True

    def _exchange(self, frames: Sequence[bytes], deadline: float) -> Any:
        (body,) = frames
        status, answer = self._request("POST", body, deadline, self._late())
        self._check(status)
        if status != http.client.OK:
            said = error_text(answer.decode(errors="replace"))
            raise PolicyError(f"{self._server}: expected an answer, got HTTP {status}: {said}")
        try:
            return _parsed(answer)
        except PackingError as error:
            raise PolicyError(f"{self._server}: {error}") from None

    def _check(self, status: int) -> None:
        if status in BUSY:
            raise Lost(f"it answered with HTTP {status}")
        if status in (401, 403, 404, 426) or 300 <= status < 400:
            redirect = ", a redirect, which is not followed" if status < 400 else ""
            hint = "give its token by option token_variable" if status in (401, 403) else "correct the address"
            raise PolicyError(f"{self._server}: expected {EXPECTED}, got HTTP {status}{redirect}; {hint}")

    def _request(self, method: str, body: bytes | None, deadline: float, late: PolicyError) -> tuple[int, bytes]:
        """Return status and body of an answer. Raises `late` if it is not there in time, and Lost without any."""
        address, token = urlsplit(self._options.address), self._token()
        headers = {"Content-Type": "application/json"} if body is not None else {}
        if token is not None:
            headers["Authorization"] = f"{self._options.token_scheme} {token}"
        left = max(0.01, deadline - time.monotonic())
        kind = http.client.HTTPSConnection if address.scheme == "https" else http.client.HTTPConnection
        connection = kind(address.hostname or "", address.port, timeout=left)
        try:
            connection.connect()
        except (OSError, UnicodeError) as error:
            raise Lost(no_connection(error)) from None
        with _ended_at(deadline, connection.sock) as ended:
            try:
                connection.request(method, address.path + (f"?{address.query}" if address.query else ""), body, headers)
                answer = connection.getresponse()
                content = answer.read(MAX_ANSWER_BYTES + 1)
            except (OSError, http.client.HTTPException) as error:
                if ended.is_set() or isinstance(error, TimeoutError):
                    raise late from None
                if isinstance(error, http.client.BadStatusLine) and not isinstance(error, ConnectionError):
                    raise PolicyError(
                        f"{self._server}: expected {EXPECTED}, got no HTTP; correct the address"
                    ) from None
                raise Lost("it closed the connection") from None
            finally:
                connection.close()
        if ended.is_set():
            raise late
        if len(content) > MAX_ANSWER_BYTES:
            limit = f"{MAX_ANSWER_BYTES >> 20} MiB"
            raise PolicyError(f"{self._server}: expected an answer of at most {limit}, got a larger one")
        return answer.status, content


def as_rows(answer: Any, actions: str | Sequence[str]) -> dict[str, Any]:
    """Return an answer, an action or a list of actions as a mapping with a chunk; a mapping unchanged.

    Raises PackingError for an array that is none, and PolicyMismatch if several keys are expected.
    """
    value = _with_arrays(answer)
    if isinstance(value, dict):
        return value
    if not isinstance(actions, str):
        raise PolicyMismatch(f"expected a mapping with {', '.join(actions)}, got an array; leave out option actions")
    rows = value if isinstance(value, list) else np.atleast_1d(value)
    return {actions: rows if any(isinstance(row, list | np.ndarray) for row in rows) else [rows]}


@contextlib.contextmanager
def _ended_at(deadline: float, connection: socket.socket) -> Iterator[threading.Event]:
    """Cut a connection at a deadline, and set the event: its own time limit holds for each piece of an answer."""
    ended = threading.Event()

    def cut() -> None:
        ended.set()
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)

    timer = threading.Timer(max(0.0, deadline - time.monotonic()), cut)
    timer.daemon = True
    timer.start()
    try:
        yield ended
    finally:
        timer.cancel()


def _parsed(text: bytes) -> Any:
    """Return the value of a JSON text. Raises PackingError for another."""
    try:
        return parse_json(text)
    except ValueError:
        raise PackingError(f"expected JSON, got {len(text)} bytes that are not") from None


def _array_as_json(value: np.ndarray) -> dict[str, Any]:
    """Return an array as json-numpy writes it."""
    data = base64.b64encode(np.ascontiguousarray(value).data).decode()
    return {"__numpy__": data, "dtype": value.dtype.str, "shape": value.shape}


def _with_arrays(value: Any, level: int = 1) -> Any:
    """Return a value of a JSON text with arrays in place of those that json-numpy wrote. Raises PackingError."""
    if level > MAX_DEPTH:
        raise PackingError(f"expected {MAX_DEPTH} levels of lists and mappings at most, got more")
    if isinstance(value, list):
        return [_with_arrays(item, level + 1) for item in value]
    if not isinstance(value, dict):
        return value
    if "__numpy__" not in value:
        return {key: _with_arrays(item, level + 1) for key, item in value.items()}
    try:
        data = base64.b64decode(value["__numpy__"], validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise PackingError("expected an array's bytes in base64, got something else") from None
    return array_of(value.get("dtype"), value.get("shape"), data)
