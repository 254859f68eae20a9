"""Messages about scheduled runs by webhook and e-mail; environment variables name the targets, see docs/operating.md.

Webhook addresses and passwords are secrets. Texts of exceptions and answers of servers may repeat them, so neither is
shown: a failure is described by its number, its type, or the message of the operating system.
"""

from __future__ import annotations

import contextlib
import html
import json
import os
import smtplib
import ssl
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from email.message import EmailMessage
from email.utils import formatdate, getaddresses
from functools import partial
from http.client import HTTPException
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from robogauntlet.results.analysis.comparison import RunComparison, Verdict
from robogauntlet.results.report.comparison import headline, reasons
from robogauntlet.results.run_document import RunDocument, RunStatus
from robogauntlet.support.errors import BadInput
from robogauntlet.support.network import is_loopback

WEBHOOK = "ROBOGAUNTLET_WEBHOOK_URL"
MAIL = "ROBOGAUNTLET_SMTP_* and ROBOGAUNTLET_MAIL_*"
HOST, PORT, TLS = "ROBOGAUNTLET_SMTP_HOST", "ROBOGAUNTLET_SMTP_PORT", "ROBOGAUNTLET_SMTP_TLS"
USER, PASSWORD = "ROBOGAUNTLET_SMTP_USER", "ROBOGAUNTLET_SMTP_PASSWORD"
SENDER, RECIPIENTS = "ROBOGAUNTLET_MAIL_FROM", "ROBOGAUNTLET_MAIL_TO"
PORTS = {"starttls": "587", "tls": "465", "none": "25"}
"""Encryption to the usual port."""
LONGEST = 3_000
"""Characters of a message; Slack and Mattermost cut or split longer ones."""
WAITS_S = (1.0, 2.0, 4.0)
"""Time before each further attempt (s)."""
TIMEOUT_S, TOTAL_S = 10.0, 60.0
"""Time limits of each answer of a server, and of sending to all targets (s)."""


@dataclass(frozen=True)
class Message:
    """A message about a run."""

    title: str
    lines: tuple[str, ...]
    """Reasons, one sentence each."""
    run: str
    """Name of the run."""
    link: str | None = None
    """Web address or path of the report."""

    @property
    def text(self) -> str:
        """A line each for the title, the run, the report and the reasons, and no other line breaks."""
        lines = [self.title, f"run: {self.run}", *([f"report: {self.link}"] if self.link else [])]
        return "\n".join(map(_one_line, [*lines, *(f"- {line}" for line in self.lines)]))[:LONGEST]


@dataclass(frozen=True)
class Target:
    """A webhook, or an e-mail server with its recipients."""

    name: str
    """Contains no secret."""
    variables: str
    """Environment variables to check after a failure."""
    send: Callable[[Message], None] = field(repr=False)
    """Sends a message once. The text of an exception may contain a secret."""


def message_for(document: RunDocument, comparison: RunComparison | None, link: str | None) -> Message | None:
    """Return the message about a run that has ended, or None if none is needed.

    A regression comes before an early stop, which is then one of the lines. Interrupted runs cause no message. For the
    link see `Message`.
    """
    ended = f"stopped early: {document.reason or 'no reason was recorded'}"
    stopped = document.status is RunStatus.STOPPED
    if comparison is not None and comparison.verdict is Verdict.REGRESSED:
        lines = (*reasons(comparison), *([ended] if stopped else []))
        return Message(headline(comparison), lines, comparison.run, link)
    complete = document.status is RunStatus.COMPLETE
    if comparison is not None and comparison.verdict is Verdict.NOT_COMPARABLE and complete:
        lines = (*reasons(comparison), f"to make this run the baseline: robogauntlet compare {comparison.run} --accept")
        return Message(headline(comparison), lines, comparison.run, link)
    if not stopped:
        return None
    run = comparison.run if comparison is not None else f"{document.suite.name} {document.run_id[:8]}"
    return Message(f"STOPPED: {run}", (ended, "the same command with the same folder continues it"), run, link)


def targets(environment: Mapping[str, str]) -> list[Target]:
    """Return a target per webhook and one for e-mail, as variables such as those of `os.environ` name them.

    Opens no connection. Empty variables count as unset.

    Raises:
        BadInput: A variable is missing or malformed. The message names it without its value.
    """
    given = {name: value.strip() for name, value in environment.items() if value.strip()}
    urls = given.get(WEBHOOK, "").split()
    found = [Target(f"webhook {i} ({_host(url)})", WEBHOOK, partial(_post, url)) for i, url in enumerate(urls, 1)]
    if any(name in given for name in (HOST, PORT, TLS, USER, PASSWORD, SENDER, RECIPIENTS)):
        found.append(_mail_target(given))
    return found


def send_all(message: Message, targets: Sequence[Target]) -> list[str]:
    """Send a message to all targets at once, and wait for them at most `TOTAL_S`.

    Returns:
        A line without secrets for each failure: target, reason, remedy.
    """
    problems: list[str | None] = [f"not sent within {TOTAL_S:g} s"] * len(targets)

    def send(i: int) -> None:
        problems[i] = _send(message, targets[i])

    # Daemons, since a server that answers byte by byte must not keep the program from ending.
    threads = [threading.Thread(target=send, args=(i,), daemon=True) for i in range(len(targets))]
    for thread in threads:
        thread.start()
    end = time.monotonic() + TOTAL_S
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
    return [
        f"the notification about {message.run} was not sent: {target.name}: {problem}; check {target.variables}"
        for target, problem in zip(targets, list(problems), strict=True)
        if problem is not None
    ]


def _send(message: Message, target: Target) -> str | None:
    """Send with retries; return None, or why it failed."""
    for wait_s in (*WAITS_S, None):
        try:
            target.send(message)
        except Exception as error:  # its text may contain a secret
            problem, is_temporary = _explain(error)
        else:
            return None
        if not is_temporary:
            return problem
        if wait_s is not None:
            time.sleep(wait_s)
    return f"{problem}, after {len(WAITS_S) + 1} tries"


def _explain(error: BaseException) -> tuple[str, bool]:
    """Why an attempt failed, without the text of the error, and whether another attempt may succeed."""
    if isinstance(error, HTTPError):
        error.close()
        return f"the server answered {error.code}", error.code == 429 or error.code >= 500
    if isinstance(error, smtplib.SMTPResponseException) and error.smtp_code > 0:
        return f"the server answered {error.smtp_code}", 400 <= error.smtp_code < 500
    if isinstance(error, URLError) and isinstance(error.reason, BaseException):
        return _explain(error.reason)
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the server's certificate was not accepted: {error.verify_message} (SSL_CERT_FILE)", False
    if isinstance(error, OSError) and (error.errno or 0) > 0 and not isinstance(error, ssl.SSLError):
        return os.strerror(error.errno or 0).lower(), True
    is_final = isinstance(error, smtplib.SMTPException) and not isinstance(error, smtplib.SMTPServerDisconnected)
    return f"failed with {type(error).__name__}", isinstance(error, OSError | HTTPException) and not is_final


class _NoRedirects(HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Return None, so that the redirection is raised as an HTTPError."""


def _post(url: str, message: Message) -> None:
    """Post a message as Slack takes it."""
    body = json.dumps({"text": html.escape(message.text, quote=False)}).encode()
    request = Request(url, body, {"Content-Type": "application/json"})
    build_opener(_NoRedirects).open(request, timeout=TIMEOUT_S).close()


def _host(url: str) -> str:
    """Scheme and host of a web address. One that contains a login is refused, since that could look like a host."""
    with contextlib.suppress(ValueError):
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
        if usable and url.isascii() and url.isprintable() and not any(sign in parts.netloc for sign in "@\\"):
            return f"{parts.scheme}://{parts.hostname}"
    raise BadInput(f"{WEBHOOK}: expected https://HOST/..., several separated by spaces; got something else")


def _mail_target(given: Mapping[str, str]) -> Target:
    host, tls = given.get(HOST, ""), given.get(TLS, "starttls").lower()
    port = given.get(PORT, PORTS.get(tls, ""))
    rules = {
        HOST: (host.isprintable() and host and not any(sign in host for sign in " /@"), "the name of a host"),
        TLS: (
            tls in PORTS and (tls != "none" or is_loopback(host)),
            "starttls, tls, or none for a server on this machine",
        ),
        PORT: (port.isascii() and port.isdigit() and 0 < int(port[:6]) < 65536, "a number from 1 to 65535"),
        SENDER: (len(_addresses(given, SENDER)) == 1, "an e-mail address"),
        RECIPIENTS: (_addresses(given, RECIPIENTS), "e-mail addresses separated by commas"),
        USER: (USER in given or PASSWORD not in given, f"a value beside {PASSWORD}"),
        PASSWORD: (PASSWORD in given or USER not in given, f"a value beside {USER}"),
    }
    for name, (is_right, expected) in rules.items():
        if not is_right:
            raise BadInput(f"{name}: expected {expected}, got {'something else' if name in given else 'nothing'}")
    return Target(f"e-mail through {host}:{port} ({tls})", MAIL, partial(_mail, given, host, int(port), tls))


def _addresses(given: Mapping[str, str], name: str) -> list[str]:
    """Addresses that are separated by commas, with or without names: `Lab <lab@example.org>`; none if one is wrong."""
    text = given.get(name, "").rstrip(",")
    found = [address for _, address in getaddresses([text])]
    return found if text.isprintable() and all(one.strip("@").count("@") == 1 for one in found) else []


def _mail(given: Mapping[str, str], host: str, port: int, tls: str, message: Message) -> None:
    """Send a message as an e-mail to all recipients, over an encrypted connection if `tls` says so, else not at all."""
    mail = EmailMessage()
    mail["Subject"] = f"[robogauntlet] {_one_line(message.title)}"
    mail["From"], mail["To"], mail["Date"] = given[SENDER], given[RECIPIENTS].rstrip(","), formatdate()
    mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: no automatic replies
    mail.set_content(message.text + "\n")
    context = ssl.create_default_context()
    opened = partial(smtplib.SMTP_SSL, context=context) if tls == "tls" else smtplib.SMTP
    with contextlib.closing(opened(host, port, timeout=TIMEOUT_S)) as server:
        if tls == "starttls":
            server.starttls(context=context)
        if USER in given:
            server.login(given[USER], given[PASSWORD])
        refused = server.send_message(mail)
        with contextlib.suppress(OSError):  # the message is delivered already
            server.quit()
    if refused:
        raise smtplib.SMTPRecipientsRefused(refused)


def _one_line(text: str) -> str:
    """The text without line breaks and unprintable characters, which could add an e-mail header."""
    plain = " ".join("".join(character if character.isprintable() else " " for character in text).split())
    return plain if len(plain) <= 1_000 else plain[:999] + "…"
