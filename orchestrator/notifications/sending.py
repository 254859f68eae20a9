"""Sends notifications by webhook and e-mail.

Webhook addresses and passwords are secrets. Texts of exceptions and answers of servers may repeat them, so neither is
shown: a failure is described by its number, its type, or the message of the operating system.
"""

from __future__ import annotations

import contextlib
import html
import json
import os
import smtplib
import socket
import ssl
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from email.headerregistry import Address
from email.message import EmailMessage
from email.utils import formatdate, make_msgid
from enum import StrEnum
from http.client import HTTPException
from typing import Any, ClassVar
from urllib.error import HTTPError, URLError
from urllib.request import HTTPRedirectHandler, Request, build_opener

from robogauntlet.orchestrator.notifications.message import Message

TOTAL_S = 60.0
"""Time after which sending is given up (s)."""
LONGEST_TEXT = 3_000
"""Characters of the lines of a webhook message; Slack and Mattermost cut or split longer texts."""


class DeliveryFailed(Exception):
    """A notification was refused; the message gives the reason without secrets."""


@dataclass(frozen=True)
class Retries:
    """Number and timing of the attempts to send."""

    waits_s: tuple[float, ...] = (1.0, 2.0, 4.0)
    """Time before each further attempt (s)."""
    timeout_s: float = 10.0
    """Time limit of each answer of a server (s)."""


@dataclass(frozen=True)
class Webhook:
    """A webhook that accepts `{"text": ...}`, as Slack does. The address is a secret."""

    name: str
    url: str = field(repr=False)
    hint: ClassVar[str] = "check the host and ROBOGAUNTLET_WEBHOOK_URL"

    def send(self, message: Message, timeout_s: float) -> None:
        """Post the message once. Redirections are not followed."""
        body = json.dumps({"text": text_of(message)}).encode()
        request = Request(self.url, body, {"Content-Type": "application/json"})
        build_opener(_NoRedirects).open(request, timeout=timeout_s).close()


class _NoRedirects(HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Return None, so that the redirection is raised as an HTTPError."""


class Tls(StrEnum):
    """How the connection to an SMTP server is encrypted."""

    STARTTLS = "starttls"
    """Encryption after a plain greeting; nothing is sent to a server that does not offer it."""
    TLS = "tls"
    NONE = "none"
    """No encryption; for this machine only."""


@dataclass(frozen=True)
class Mail:
    """An SMTP server, the sender and the recipients. Certificates are checked."""

    host: str
    port: int
    sender: Address
    recipients: tuple[Address, ...]
    tls: Tls = Tls.STARTTLS
    user: str | None = field(default=None, repr=False)
    password: str | None = field(default=None, repr=False)
    hint: ClassVar[str] = "check ROBOGAUNTLET_SMTP_* and ROBOGAUNTLET_MAIL_*"

    @property
    def name(self) -> str:
        """Server and encryption."""
        return f"e-mail through {self.host}:{self.port} ({self.tls})"

    def send(self, message: Message, timeout_s: float) -> None:
        """Send the message once, to all recipients."""
        context = ssl.create_default_context()
        if self.tls is Tls.TLS:
            server: smtplib.SMTP = smtplib.SMTP_SSL(self.host, self.port, timeout=timeout_s, context=context)
        else:
            server = smtplib.SMTP(self.host, self.port, timeout=timeout_s)
        with contextlib.closing(server):
            if self.tls is Tls.STARTTLS:
                server.starttls(context=context)
            if self.user is not None and self.password is not None:
                server.login(self.user, self.password)
            refused = server.send_message(email_message(message, self.sender, self.recipients))
            with contextlib.suppress(OSError):  # the message is delivered already
                server.quit()
        if refused:
            places = [str(i) for i, address in enumerate(self.recipients, 1) if address.addr_spec in refused]
            raise DeliveryFailed(f"the server refused number {', '.join(places)} in ROBOGAUNTLET_MAIL_TO")


Notifier = Webhook | Mail
"""Sends notifications to one target. Its `name` contains no secret, but the text of an exception of `send` may.

`hint` says what to check after a failure.
"""


def send_all(
    message: Message, notifiers: Sequence[Notifier], *, retries: Retries = Retries(), total_s: float = TOTAL_S
) -> list[str]:
    """Send a notification to all targets at once, and wait for them at most `total_s`.

    Returns:
        A line without secrets for each failure: target, reason, remedy.
    """
    problems: list[str | None] = [f"not sent within {total_s:g} s"] * len(notifiers)

    def send(i: int) -> None:
        problems[i] = _send(message, notifiers[i], retries)

    # Daemons, since a server that answers byte by byte must not keep the program from ending.
    threads = [threading.Thread(target=send, args=(i,), daemon=True) for i in range(len(notifiers))]
    for thread in threads:
        thread.start()
    end = time.monotonic() + total_s
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
    return [
        f"the notification about {message.run} was not sent: {notifier.name}: {problem}; {notifier.hint}"
        for notifier, problem in zip(notifiers, list(problems), strict=True)
        if problem is not None
    ]


def text_of(message: Message) -> str:
    """Render a notification in Slack's markup, in which `&`, `<` and `>` are escaped."""
    body = "\n".join(f"• {line}" for line in message.lines)
    body = body if len(body) <= LONGEST_TEXT else body[: LONGEST_TEXT - 1] + "…"
    return html.escape("\n".join([f"*{message.title}*", body, *message.footer]), quote=False)


def email_message(message: Message, sender: Address, recipients: tuple[Address, ...]) -> EmailMessage:
    """Render a notification as an e-mail in plain text."""
    mail = EmailMessage()
    mail["Subject"] = f"[robogauntlet] {message.title}"
    mail["From"] = sender
    mail["To"] = recipients
    mail["Date"] = formatdate()
    mail["Message-ID"] = make_msgid(domain=sender.domain)
    mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: no automatic replies
    lines = [message.title, "", *(f"- {line}" for line in message.lines), "", *message.footer]
    mail.set_content("\n".join(lines) + "\n")
    return mail


def _send(message: Message, notifier: Notifier, retries: Retries) -> str | None:
    """Send with retries; return None, or why it failed."""
    for wait_s in (*retries.waits_s, None):
        try:
            notifier.send(message, retries.timeout_s)
        except Exception as error:  # its text may contain a secret
            problem, can_retry = _explain(error)
        else:
            return None
        if not can_retry:
            return problem
        if wait_s is not None:
            time.sleep(wait_s)
    return f"{problem}, after {len(retries.waits_s) + 1} tries"


def _explain(error: BaseException) -> tuple[str, bool]:
    """Why an attempt failed, without the text of the error, and whether another attempt may succeed."""
    if isinstance(error, DeliveryFailed):
        return str(error), False
    if isinstance(error, HTTPError):
        error.close()
        return f"the server answered {error.code}", error.code == 429 or error.code >= 500
    if isinstance(error, smtplib.SMTPRecipientsRefused):
        codes = sorted({code for code, _ in error.recipients.values()})
        return f"the server refused all recipients ({', '.join(map(str, codes))})", all(code < 500 for code in codes)
    if isinstance(error, smtplib.SMTPResponseException) and error.smtp_code > 0:
        return f"the server answered {error.smtp_code}", 400 <= error.smtp_code < 500
    if isinstance(error, URLError) and isinstance(error.reason, BaseException):
        return _explain(error.reason)
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the server's certificate was not accepted: {error.verify_message} (SSL_CERT_FILE)", False
    if isinstance(error, socket.gaierror):
        return "the host was not found", True
    if isinstance(error, TimeoutError):
        return "no answer in time", True
    if isinstance(error, OSError) and error.errno is not None and not isinstance(error, ssl.SSLError):
        return os.strerror(error.errno).lower(), True
    is_final = isinstance(error, smtplib.SMTPException) and not isinstance(error, smtplib.SMTPServerDisconnected)
    return f"failed with {type(error).__name__}", isinstance(error, OSError | HTTPException) and not is_final
