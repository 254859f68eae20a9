"""What every way to tell people has in common: when to try again, and how to say that it did not work.

Addresses of webhooks and passwords are secrets, and texts of exceptions and answers of servers often repeat them. So
neither is ever quoted: what is said of a failure is made here, from its type, its number, or a word of a known list.
"""

from __future__ import annotations

import http.client
import os
import socket
import ssl
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import requests
from urllib3 import BaseHTTPResponse
from urllib3.exceptions import HTTPError, InvalidHeader
from urllib3.exceptions import TimeoutError as PoolTimeout
from urllib3.util.retry import Retry

from orchestrator.telling.message import Message


class TellingError(Exception):
    """The environment does not say how to tell people; a line per problem, which names variables and never values."""


class NotTold(Exception):
    """A message did not arrive; the text says what came and what to do, and has no secret."""


class Teller(Protocol):
    """A way to tell people."""

    @property
    def name(self) -> str:
        """Which one this is, without its secrets."""

    def send(self, message: Message) -> None:
        """Send a message, as often as it takes.

        Raises:
            NotTold: It did not arrive.
        """


@dataclass(frozen=True)
class Retries:
    """How often to try, and how long to wait in between."""

    tries: int = 4
    wait_s: float = 1.0
    """Unit of the waits: none before the second try, then 2, 4, 8 ... of these."""
    timeout_s: float = 10.0
    """For which one answer is waited."""
    longest_wait_s: int = 10
    """Between two tries, whatever a server asks for."""

    def retry(self) -> Retry:
        """The same for urllib3: too many requests, broken servers and broken connections are tried again."""
        return _Retry(
            total=self.tries - 1,
            allowed_methods=None,
            status_forcelist={429, *range(500, 600)},
            backoff_factor=self.wait_s,
            backoff_max=self.longest_wait_s,
            retry_after_max=self.longest_wait_s,
            raise_on_status=False,
        )


RETRIES = Retries()


class _Retry(Retry):
    def get_retry_after(self, response: BaseHTTPResponse) -> float | None:
        try:
            return super().get_retry_after(response)
        except (InvalidHeader, ValueError, OverflowError):
            return None  # a Retry-After that says nothing, such as "1.5": as if it was not there


def what_came(error: BaseException) -> str:
    """An error of the network in words, none of which are the error's own.

    Args:
        error: As it was raised, by requests, urllib3, smtplib or sockets.
    """
    causes = list(_causes(error))
    for cause in causes:
        if isinstance(cause, ssl.SSLCertVerificationError):
            return (
                f"its certificate was not accepted: {cause.verify_message.rstrip('.')}"  # OpenSSL's words, no server's
            )
        if isinstance(cause, ssl.SSLError):
            return "it does not speak TLS, or another version of it"
        if isinstance(cause, socket.gaierror):
            return "no host has this name, or no name server was reached"
        if isinstance(cause, http.client.RemoteDisconnected):
            return "it closed the connection without an answer"
        if isinstance(cause, ConnectionError) and cause.errno:
            return os.strerror(cause.errno).lower()
    if any(isinstance(cause, requests.exceptions.ProxyError) for cause in causes):
        return "the proxy did not let it through (HTTPS_PROXY, HTTP_PROXY)"
    if any(isinstance(cause, TimeoutError | PoolTimeout | requests.Timeout) for cause in causes):
        return "no answer in time"
    for cause in causes:
        if isinstance(cause, OSError) and cause.errno in _SYSTEM:
            return os.strerror(cause.errno).lower()
        if isinstance(cause, http.client.HTTPException | HTTPError) and not isinstance(
            cause, requests.RequestException
        ):
            return "what it answered is not HTTP"
    return f"unexpected {type(error).__name__}"


_SYSTEM = frozenset(range(1, 200))
"""Numbers of the operating system's errors; others' are their own."""


def _causes(error: BaseException) -> Iterator[BaseException]:
    """An error and what it was made of: requests and urllib3 hold it as a cause, a context, an argument or a reason."""
    seen: list[BaseException] = []
    open_: list[object] = [error]
    while open_:
        one = open_.pop(0)
        if isinstance(one, BaseException) and not any(one is other for other in seen):
            seen.append(one)
            yield one
            open_ += [*one.args, getattr(one, "reason", None), one.__cause__, one.__context__]
