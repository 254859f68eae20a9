"""A websocket to a policy's server: made when it is needed, made again when it is lost."""

from __future__ import annotations

import contextlib
import ipaddress
import math
import os
import socket
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar
from urllib.parse import urlsplit

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, WebSocketException
from websockets.frames import CloseCode
from websockets.sync.client import ClientConnection, connect

from policies.contract import PolicyError
from policies.remote.card import Card
from policies.remote.packing import PackingError, pack, unpack

MOST_BYTES = 16 * 2**20
"""Of a frame that a server sends."""
LONGEST_LINE = 300
LONGEST_STALL_S = 10.0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 2.0
Found = TypeVar("Found")
REFUSED = (400, 401, 403, 404, 426)
"""HTTP answers that asking again does not change."""


class _Lost(Exception):
    """The connection is gone; it may be made again."""


class Line:
    """The connection of one process to one server."""

    def __init__(self, card: Card) -> None:
        """Nothing is connected yet. Args: card: where to, and how long to wait."""
        self._card = card
        self._connection: ClientConnection | None = None
        self._held = contextlib.ExitStack()
        self.metadata: Mapping[str, Any] = {}
        """What the server said on the last connection."""
        self.made = 0
        """Connections so far."""

    def connect(self) -> None:
        """Connect, unless that is done.

        Raises:
            PolicyError: In one line, why there is no connection.
        """
        self._patiently(self._connected, self._card.connect_timeout_s)

    def ask(self, frame: Callable[[], bytes]) -> Mapping[str, Any]:
        """The server's answer; a lost connection is made again, and the question asked again.

        Args:
            frame: Makes the message, once there is a connection: what it says may depend on `metadata` and `made`.

        Raises:
            PolicyError: There is no answer in time, or none that can be read; in one line.
            Exception: What `frame` raises.
        """

        def exchange(deadline: float) -> Mapping[str, Any]:
            return self._exchange(self._connected(deadline), frame(), deadline)

        return self._patiently(exchange, self._card.timeout_s)

    def close(self) -> None:
        """Hang up. The next question connects anew."""
        connection, self._connection = self._connection, None
        if connection is not None:
            # A late answer must never be taken for that to the next question, nor be waited for.
            with contextlib.suppress(OSError):
                connection.socket.shutdown(socket.SHUT_RDWR)
        self._held.close()

    @property
    def _server(self) -> str:
        return f"policy server {self._card.address}"

    def _patiently(self, what: Callable[[float], Found], seconds: float) -> Found:
        deadline = time.monotonic() + seconds
        for attempt in range(self._card.retries + 1):
            try:
                return what(deadline)
            except _Lost as lost:
                reason = str(lost)
                left = deadline - time.monotonic()
                if attempt == self._card.retries or left <= 0:
                    break
                time.sleep(min(FIRST_PAUSE_S * 2**attempt, LONGEST_PAUSE_S, left))
        raise PolicyError(
            f"{self._server}: expected an answer within {attempt + 1} attempts and {seconds:g} s, got none: {reason}; "
            "start the server, correct the address, or raise retries"
        )

    def _connected(self, deadline: float) -> ClientConnection:
        if self._connection is None:
            left = min(self._card.connect_timeout_s, max(0.0, deadline - time.monotonic()))
            try:
                self._connection = self._dial(left)
                self.metadata = self._greeting(self._connection, time.monotonic() + left)
                self.made += 1
            except BaseException:
                self.close()
                raise
        return self._connection

    def _dial(self, seconds: float) -> ClientConnection:
        card = self._card
        try:
            # Frames are big and hardly compressible. A server may be deaf while it computes: the deadline decides.
            connection: ClientConnection = self._held.enter_context(
                connect(
                    card.address,
                    compression=None,
                    max_size=MOST_BYTES,
                    open_timeout=seconds,
                    ping_interval=None,
                    close_timeout=1,
                    additional_headers=self._headers(),
                    proxy=None if _is_loopback(card.address) else True,
                )
            )
        except InvalidStatus as refused:
            code = refused.response.status_code
            if code not in REFUSED:
                raise _Lost(f"it answered with HTTP {code}") from None
            hint = "give its token by option token_variable" if code in (401, 403) else "correct the address"
            raise PolicyError(f"{self._server}: expected a websocket, got HTTP {code}; {hint}") from None
        except (TimeoutError, InvalidHandshake, EOFError, OSError, WebSocketException) as error:
            raise _Lost(_why(error)) from None
        # `recv` has a deadline, `send` has none: where nothing can be sent for so long, the kernel gives up.
        wait = struct.pack("ll", math.ceil(min(card.timeout_s, LONGEST_STALL_S)), 0)
        with contextlib.suppress(OSError):  # closed already: `recv` says what came before that
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, wait)
        return connection

    def _headers(self) -> dict[str, str]:
        variable = self._card.token_variable
        if variable is None:
            return {}
        token = os.environ.get(variable, "")
        if not token or not token.isascii() or not token.isprintable():
            raise PolicyError(f"{self._server}: expected its token in the environment variable {variable}, got none")
        return {"Authorization": f"{self._card.token_scheme} {token}"}

    def _greeting(self, connection: ClientConnection, deadline: float) -> Mapping[str, Any]:
        expected = "expected metadata on connection, as openpi's servers send"
        try:
            frame = connection.recv(timeout=max(0.0, deadline - time.monotonic()))
        except TimeoutError:
            raise PolicyError(
                f"{self._server}: {expected}, got nothing in time; is it another kind of server?"
            ) from None
        except ConnectionClosed as closed:
            raise self._ended(closed) from None
        return self._read(frame, expected)

    def _exchange(self, connection: ClientConnection, frame: bytes, deadline: float) -> Mapping[str, Any]:
        answered = False
        try:
            connection.send(frame)
            answer = connection.recv(timeout=max(0.0, deadline - time.monotonic()))
            found = self._read(answer, "expected an answer")
            answered = True
        except TimeoutError:
            raise PolicyError(
                f"{self._server}: expected an answer within {self._card.timeout_s:g} s, got none; "
                "raise timeout_s or look after the server"
            ) from None
        except ConnectionClosed as closed:
            raise self._ended(closed) from None
        finally:
            if not answered:
                self.close()
        return found

    def _ended(self, closed: ConnectionClosed) -> Exception:
        ends = [end for end in (closed.rcvd, closed.sent) if end is not None]
        if any(end.code == CloseCode.MESSAGE_TOO_BIG for end in ends):
            who = "the server takes" if closed.rcvd else f"{MOST_BYTES >> 20} MiB"
            return PolicyError(f"{self._server}: expected frames no bigger than {who}, got one; send smaller images")
        return _Lost(f"it hung up: {ends[0]}" if ends else "it hung up")

    def _read(self, frame: str | bytes, expected: str) -> Mapping[str, Any]:
        if isinstance(frame, str):
            lines = [line for line in frame.splitlines() if line.strip()] or ["(nothing)"]
            said = "".join(c for c in lines[-1].strip() if c.isprintable())[:LONGEST_LINE]
            raise PolicyError(f"{self._server}: {expected}, got an error: {said}")
        try:
            message = unpack(frame)
        except PackingError as error:
            raise PolicyError(f"{self._server}: {expected}: {error}") from None
        if not isinstance(message, dict):
            raise PolicyError(f"{self._server}: {expected}, a mapping, got a {type(message).__name__}")
        return message


def packed(message: Mapping[str, Any]) -> bytes:
    """A message to be asked.

    Raises:
        PolicyError: It cannot be sent.
    """
    try:
        return pack(message)
    except PackingError as error:
        raise PolicyError(f"observation: {error}") from None


def _why(error: BaseException) -> str:
    if isinstance(error, TimeoutError):
        return "no connection in time"
    if isinstance(error, OSError):
        return f"no connection: {error.strerror or error}".lower()
    return f"it speaks no websocket: {str(error).splitlines()[0] if str(error) else type(error).__name__}"


def _is_loopback(address: str) -> bool:
    host = urlsplit(address).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
