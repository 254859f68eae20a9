"""The connection of one process to one policy server: opened on first use, and again after it was lost."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from robogauntlet.policies.contract import PolicyError, PolicyUnreachable
from robogauntlet.policies.remote.msgpack_numpy import PackingError, pack
from robogauntlet.policies.remote.server_options import ServerOptions
from robogauntlet.support.errors import last_line
from robogauntlet.support.text import visible

MAX_FRAME_BYTES = 16 * 2**20
"""Largest frame that a server may send."""
MAX_GREETING_BYTES = 2**20
"""Largest metadata that a server may send on connection."""
MAX_ERROR_LENGTH = 300
FIRST_PAUSE_S, MAX_PAUSE_S = 0.1, 2.0
Result = TypeVar("Result")


class Lost(Exception):
    """The connection is lost; it may be opened again."""


class ServerConnection:
    """Base of the connections to a server; each transport has its own."""

    def __init__(self, options: ServerOptions) -> None:
        self._options = options
        self.number = 0
        """Number of connections so far."""

    def connect(self) -> None:
        """Connect if there is no connection yet. Raises PolicyError with the reason if that fails."""
        self._retry(self._connect, self._options.connect_timeout_s)

    def ask(self, frames: Callable[[], Sequence[bytes]]) -> Any:
        """Return the server's one answer to some frames; after a lost connection, connect and ask again.

        `frames` builds them once there is a connection, since they may depend on its metadata and `number`. Raises
        PolicyError if the answer is late or cannot be read.
        """

        def attempt(deadline: float) -> Any:
            self._connect(deadline)
            sent, answered = frames(), False
            try:
                answer = self._exchange(sent, deadline)
                answered = True
            finally:
                if not answered:
                    self.close()
            return answer

        return self._retry(attempt, self._options.timeout_s)

    def close(self) -> None:
        """Close the connection. The next question connects again."""
        raise NotImplementedError

    @property
    def _is_open(self) -> bool:
        raise NotImplementedError

    def _open(self, seconds: float) -> None:
        """Connect, and read what the server says of itself. Raises PolicyError, or Lost to try again."""
        raise NotImplementedError

    def _exchange(self, frames: Sequence[bytes], deadline: float) -> Any:
        """Send frames over the open connection and return the answer. Raises PolicyError, or Lost to try again."""
        raise NotImplementedError

    @property
    def _server(self) -> str:
        return f"policy server {self._options.address}"

    def _retry(self, attempt_once: Callable[[float], Result], seconds: float) -> Result:
        deadline = time.monotonic() + seconds
        for attempt in range(self._options.retries + 1):
            try:
                return attempt_once(deadline)
            except Lost as lost:
                reason = str(lost)
                left = deadline - time.monotonic()
                if attempt == self._options.retries or left <= 0:
                    break
                time.sleep(min(FIRST_PAUSE_S * 2**attempt, MAX_PAUSE_S, left))
        raise PolicyUnreachable(
            f"{self._server}: expected an answer within {attempt + 1} attempts and {seconds:g} s, got none: {reason}; "
            "start the server, correct the address, or raise retries"
        )

    def _connect(self, deadline: float) -> None:
        if self._is_open:
            return
        try:
            self._open(min(self._options.connect_timeout_s, max(0.0, deadline - time.monotonic())))
            self.number += 1
        except BaseException:
            self.close()
            raise

    def _token(self) -> str | None:
        """Return the server's token, None without the option. Raises PolicyError if its variable is not set."""
        variable = self._options.token_variable
        if variable is None:
            return None
        token = os.environ.get(variable, "")
        if not token or not token.isascii() or not token.isprintable():
            raise PolicyError(f"{self._server}: expected its token in the environment variable {variable}, got none")
        return token

    def _late(self) -> PolicyError:
        """The error of an answer that did not come in time."""
        return PolicyError(
            f"{self._server}: expected an answer within {self._options.timeout_s:g} s, got none; "
            "raise timeout_s or check the server"
        )


def error_text(text: object) -> str:
    """Return the last line of an error that a server sent, made safe to show."""
    return visible(last_line(str(text)[-10 * MAX_ERROR_LENGTH :]))[:MAX_ERROR_LENGTH]


def no_connection(error: OSError | UnicodeError) -> str:
    """The reason why an address cannot be reached, such as a host whose name is none."""
    if isinstance(error, TimeoutError):
        return "no connection in time"
    return f"no connection: {getattr(error, 'strerror', None) or error}".lower()


def packed(message: Any) -> bytes:
    """Return a query's message as bytes. Raises PolicyError if it cannot be sent."""
    try:
        return pack(message)
    except PackingError as error:
        raise PolicyError(f"observation: {error}") from None
