"""A connection to a policy server by websocket."""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, WebSocketException
from websockets.frames import Close, CloseCode
from websockets.sync.client import ClientConnection, connect

from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.remote.connection import (
    MAX_FRAME_BYTES,
    MAX_GREETING_BYTES,
    Lost,
    ServerConnection,
    error_text,
    no_connection,
)
from robogauntlet.policies.remote.msgpack_numpy import PackingError, unpack
from robogauntlet.policies.remote.server_options import ServerOptions
from robogauntlet.support.errors import first_line
from robogauntlet.support.network import is_loopback

MAX_STALL_S = 10.0
REFUSED = (400, 401, 403, 404, 426)
"""HTTP status codes after which no retry is made."""


class _Redirected(Exception):
    """The server names another address, with this HTTP status code."""


class _DirectConnection(ClientConnection):
    """A connection to the address that the user gave, and to no other, however a server answers."""

    def handshake(self, *arguments: Any, **options: Any) -> None:
        """Shake hands. Raises _Redirected where the library would follow to any host."""
        try:
            super().handshake(*arguments, **options)
        except InvalidStatus as refused:
            if 300 <= refused.response.status_code < 400:
                raise _Redirected(refused.response.status_code) from None
            raise


@dataclass(frozen=True)
class Opening:
    """How the connections of a protocol begin."""

    expected: str
    """What the server sends first, for messages."""
    accept: Callable[[Mapping[str, Any]], None]
    """Called with what it sends first. Raises PolicyError for a server that is refused."""
    hello: bytes | None = None
    """What the client sends before."""
    alone: str = ""
    """Key of an answer that is an array alone; "" if that is an error."""
    explain: Callable[[object], str] = error_text
    """Returns the error in a text frame, made safe to show."""


class WebsocketConnection(ServerConnection):
    """A websocket to one server."""

    def __init__(self, options: ServerOptions, opening: Opening) -> None:
        super().__init__(options)
        self._opening = opening
        self._connection: ClientConnection | None = None
        self._exit_stack = contextlib.ExitStack()

    def tell(self, frame: bytes) -> None:
        """Send a frame that has no answer, if there is a connection."""
        if self._connection is not None:
            with contextlib.suppress(OSError, WebSocketException):  # the next question finds out
                self._connection.send(frame)

    def close(self) -> None:
        """Close the connection. The next question connects again."""
        connection, self._connection = self._connection, None
        if connection is not None:
            # A late answer must neither be taken for the next question's nor be waited for.
            with contextlib.suppress(OSError):
                connection.socket.shutdown(socket.SHUT_RDWR)
        self._exit_stack.close()

    @property
    def _is_open(self) -> bool:
        return self._connection is not None

    def _open(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        self._connection = self._shake_hands(seconds)
        self._greet(self._connection, deadline)

    def _shake_hands(self, seconds: float) -> ClientConnection:
        options = self._options
        try:
            # Frames are large and hardly compressible. A server may ignore pings while it computes.
            connection: ClientConnection = self._exit_stack.enter_context(
                connect(
                    options.address,
                    compression=None,
                    max_size=MAX_FRAME_BYTES,
                    max_queue=1,  # what a server sends unasked waits in its own memory
                    open_timeout=seconds,
                    ping_interval=None,
                    close_timeout=1,
                    additional_headers=self._headers(),
                    create_connection=_DirectConnection,
                    proxy=None if is_loopback(urlsplit(options.address).hostname or "") else True,
                )
            )
        except _Redirected as redirect:
            raise PolicyError(
                f"{self._server}: expected a websocket, got HTTP {redirect}, a redirect, which is not followed; "
                "correct the address"
            ) from None
        except InvalidStatus as refused:
            code = refused.response.status_code
            if code not in REFUSED:
                raise Lost(f"it answered with HTTP {code}") from None
            hint = "give its token by option token_variable" if code in (401, 403) else "correct the address"
            raise PolicyError(f"{self._server}: expected a websocket, got HTTP {code}; {hint}") from None
        except (TimeoutError, InvalidHandshake, EOFError, OSError, WebSocketException) as error:
            raise Lost(_reason(error)) from None
        # `recv` has a deadline, `send` has none: the kernel gives up when nothing can be sent for this long.
        wait = struct.pack("ll", math.ceil(min(options.timeout_s, MAX_STALL_S)), 0)
        with contextlib.suppress(OSError):  # already closed: `recv` raises the reason
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, wait)
        return connection

    def _headers(self) -> dict[str, str]:
        token = self._token()
        return {} if token is None else {"Authorization": f"{self._options.token_scheme} {token}"}

    def _greet(self, connection: ClientConnection, deadline: float) -> None:
        expected = f"expected {self._opening.expected}"
        try:
            if self._opening.hello is not None:
                connection.send(self._opening.hello)
            frame = connection.recv(timeout=max(0.0, deadline - time.monotonic()))
        except TimeoutError:
            if ended := _unreadable(getattr(connection.protocol, "close_sent", None)):
                raise ended from None
            raise PolicyError(
                f"{self._server}: {expected}, got nothing in time; is it another kind of server?"
            ) from None
        except ConnectionClosed as closed:
            raise self._ended(closed) from None
        if len(frame) > MAX_GREETING_BYTES:
            limit = f"{MAX_GREETING_BYTES >> 20} MiB"
            raise PolicyError(f"{self._server}: {expected}, of at most {limit}, got {len(frame)} bytes")
        self._opening.accept(self._read(frame, expected))

    def _exchange(self, frames: Sequence[bytes], deadline: float) -> Mapping[str, Any]:
        connection = self._connection
        assert connection is not None
        try:
            for frame in frames:
                connection.send(frame)
            answer = connection.recv(timeout=max(0.0, deadline - time.monotonic()))
        except TimeoutError:
            if ended := _unreadable(getattr(connection.protocol, "close_sent", None)):
                raise ended from None
            raise self._late() from None
        except ConnectionClosed as closed:
            raise self._ended(closed) from None
        return self._read(answer, "expected an answer", self._opening.alone)

    def _ended(self, closed: ConnectionClosed) -> Exception:
        ends = [end for end in (closed.rcvd, closed.sent) if end is not None]
        if any(end.code == CloseCode.MESSAGE_TOO_BIG for end in ends):
            limit = "the server takes" if closed.rcvd else f"{MAX_FRAME_BYTES >> 20} MiB"
            return PolicyError(f"{self._server}: expected frames no larger than {limit}, got one; send smaller images")
        if not closed.rcvd_then_sent and (unreadable := _unreadable(closed.sent)):
            return unreadable
        return Lost(f"it closed the connection: {ends[0]}" if ends else "it closed the connection")

    def _read(self, frame: str | bytes, expected: str, alone: str = "") -> Mapping[str, Any]:
        if isinstance(frame, str):
            raise PolicyError(f"{self._server}: {expected}, got an error: {self._opening.explain(frame)}")
        try:
            message = unpack(frame)
        except PackingError as error:
            raise PolicyError(f"{self._server}: {expected}: {error}") from None
        if alone and isinstance(message, np.ndarray):
            return {alone: message}
        if not isinstance(message, dict):
            raise PolicyError(f"{self._server}: {expected}, a mapping, got {type(message).__name__}")
        return message


def _unreadable(sent: Close | None) -> Lost | None:
    """What ended a connection that this side closed since it could not read a frame; the server may still be there."""
    if sent is None or sent.code not in (CloseCode.PROTOCOL_ERROR, CloseCode.INVALID_DATA):
        return None
    return Lost(f"it sent what is no frame of a websocket: {sent.reason or sent.code}")


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError):  # or its kind TimeoutError
        return no_connection(error)
    return f"it is no websocket server: {first_line(error)}"
