"""A websocket to a policy server: connects on first use, and again after a lost connection."""

from __future__ import annotations

import contextlib
import math
import os
import socket
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar
from urllib.parse import urlsplit

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, WebSocketException
from websockets.frames import Close, CloseCode
from websockets.sync.client import ClientConnection, connect

from robogauntlet.policies.contract import PolicyError, PolicyUnreachable
from robogauntlet.policies.remote.msgpack_numpy import PackingError, pack, unpack
from robogauntlet.policies.remote.server_options import ServerOptions
from robogauntlet.support.errors import first_line, last_line
from robogauntlet.support.network import is_loopback

MAX_FRAME_BYTES = 16 * 2**20
"""Largest frame that a server may send."""
MAX_GREETING_BYTES = 2**20
"""Largest metadata that a server may send on connection."""
MAX_ERROR_LENGTH = 300
MAX_STALL_S = 10.0
FIRST_PAUSE_S, MAX_PAUSE_S = 0.1, 2.0
Result = TypeVar("Result")
REFUSED = (400, 401, 403, 404, 426)
"""HTTP status codes after which no retry is made."""


class _Lost(Exception):
    """The connection is lost; it may be opened again."""


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


class ServerConnection:
    """The connection of one process to one server."""

    def __init__(self, options: ServerOptions, opening: Opening) -> None:
        self._options, self._opening = options, opening
        self._connection: ClientConnection | None = None
        self._exit_stack = contextlib.ExitStack()
        self.number = 0
        """Number of connections so far."""

    def connect(self) -> None:
        """Connect if there is no connection yet. Raises PolicyError with the reason if that fails."""
        self._retry(self._connected, self._options.connect_timeout_s)

    def ask(self, frames: Callable[[], Sequence[bytes]]) -> Mapping[str, Any]:
        """Return the server's one answer to some frames; after a lost connection, connect and ask again.

        `frames` builds them once there is a connection, since they may depend on its metadata and `number`. Raises
        PolicyError if the answer is late or cannot be read.
        """
        return self._retry(
            lambda deadline: self._exchange(self._connected(deadline), frames(), deadline), self._options.timeout_s
        )

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
    def _server(self) -> str:
        return f"policy server {self._options.address}"

    def _retry(self, attempt_once: Callable[[float], Result], seconds: float) -> Result:
        deadline = time.monotonic() + seconds
        for attempt in range(self._options.retries + 1):
            try:
                return attempt_once(deadline)
            except _Lost as lost:
                reason = str(lost)
                left = deadline - time.monotonic()
                if attempt == self._options.retries or left <= 0:
                    break
                time.sleep(min(FIRST_PAUSE_S * 2**attempt, MAX_PAUSE_S, left))
        raise PolicyUnreachable(
            f"{self._server}: expected an answer within {attempt + 1} attempts and {seconds:g} s, got none: {reason}; "
            "start the server, correct the address, or raise retries"
        )

    def _connected(self, deadline: float) -> ClientConnection:
        if self._connection is None:
            left = min(self._options.connect_timeout_s, max(0.0, deadline - time.monotonic()))
            try:
                self._connection = self._connect(left)
                self._greet(self._connection, time.monotonic() + left)
                self.number += 1
            except BaseException:
                self.close()
                raise
        return self._connection

    def _connect(self, seconds: float) -> ClientConnection:
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
                raise _Lost(f"it answered with HTTP {code}") from None
            hint = "give its token by option token_variable" if code in (401, 403) else "correct the address"
            raise PolicyError(f"{self._server}: expected a websocket, got HTTP {code}; {hint}") from None
        except (TimeoutError, InvalidHandshake, EOFError, OSError, WebSocketException) as error:
            raise _Lost(_reason(error)) from None
        # `recv` has a deadline, `send` has none: the kernel gives up when nothing can be sent for this long.
        wait = struct.pack("ll", math.ceil(min(options.timeout_s, MAX_STALL_S)), 0)
        with contextlib.suppress(OSError):  # already closed: `recv` raises the reason
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, wait)
        return connection

    def _headers(self) -> dict[str, str]:
        variable = self._options.token_variable
        if variable is None:
            return {}
        token = os.environ.get(variable, "")
        if not token or not token.isascii() or not token.isprintable():
            raise PolicyError(f"{self._server}: expected its token in the environment variable {variable}, got none")
        return {"Authorization": f"{self._options.token_scheme} {token}"}

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

    def _exchange(self, connection: ClientConnection, frames: Sequence[bytes], deadline: float) -> Mapping[str, Any]:
        answered = False
        try:
            for frame in frames:
                connection.send(frame)
            answer = connection.recv(timeout=max(0.0, deadline - time.monotonic()))
            message = self._read(answer, "expected an answer")
            answered = True
        except TimeoutError:
            if ended := _unreadable(getattr(connection.protocol, "close_sent", None)):
                raise ended from None
            raise PolicyError(
                f"{self._server}: expected an answer within {self._options.timeout_s:g} s, got none; "
                "raise timeout_s or check the server"
            ) from None
        except ConnectionClosed as closed:
            raise self._ended(closed) from None
        finally:
            if not answered:
                self.close()
        return message

    def _ended(self, closed: ConnectionClosed) -> Exception:
        ends = [end for end in (closed.rcvd, closed.sent) if end is not None]
        if any(end.code == CloseCode.MESSAGE_TOO_BIG for end in ends):
            limit = "the server takes" if closed.rcvd else f"{MAX_FRAME_BYTES >> 20} MiB"
            return PolicyError(f"{self._server}: expected frames no larger than {limit}, got one; send smaller images")
        if not closed.rcvd_then_sent and (unreadable := _unreadable(closed.sent)):
            return unreadable
        return _Lost(f"it closed the connection: {ends[0]}" if ends else "it closed the connection")

    def _read(self, frame: str | bytes, expected: str) -> Mapping[str, Any]:
        if isinstance(frame, str):
            message_text = "".join(c for c in last_line(frame[-10 * MAX_ERROR_LENGTH :]) if c.isprintable())[
                :MAX_ERROR_LENGTH
            ]
            raise PolicyError(f"{self._server}: {expected}, got an error: {message_text}")
        try:
            message = unpack(frame)
        except PackingError as error:
            raise PolicyError(f"{self._server}: {expected}: {error}") from None
        if not isinstance(message, dict):
            raise PolicyError(f"{self._server}: {expected}, a mapping, got {type(message).__name__}")
        return message


def _unreadable(sent: Close | None) -> _Lost | None:
    """What ended a connection that this side closed since it could not read a frame; the server may still be there."""
    if sent is None or sent.code not in (CloseCode.PROTOCOL_ERROR, CloseCode.INVALID_DATA):
        return None
    return _Lost(f"it sent what is no frame of a websocket: {sent.reason or sent.code}")


def packed(message: Mapping[str, Any]) -> bytes:
    """Return a query's message as bytes. Raises PolicyError if it cannot be sent."""
    try:
        return pack(message)
    except PackingError as error:
        raise PolicyError(f"observation: {error}") from None


def _reason(error: BaseException) -> str:
    if isinstance(error, TimeoutError):
        return "no connection in time"
    if isinstance(error, OSError):
        return f"no connection: {error.strerror or error}".lower()
    return f"it is no websocket server: {first_line(error)}"
