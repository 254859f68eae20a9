"""Tells by e-mail through an SMTP server."""

from __future__ import annotations

import contextlib
import smtplib
import ssl
from dataclasses import dataclass, field
from email.headerregistry import Address
from email.message import EmailMessage
from email.utils import formatdate, make_msgid
from enum import StrEnum

from urllib3.exceptions import MaxRetryError

from orchestrator.telling.message import Message
from orchestrator.telling.teller import RETRIES, NotTold, Retries, what_came


class Tls(StrEnum):
    """How the connection is encrypted."""

    STARTTLS = "starttls"
    """Begun in the clear and encrypted before anything is said; a server that cannot is told nothing."""
    TLS = "tls"
    NONE = "none"
    """Not at all; to this machine only."""


PORTS = {Tls.STARTTLS: 587, Tls.TLS: 465, Tls.NONE: 25}


@dataclass(frozen=True)
class Mail:
    """An SMTP server, and who writes to whom."""

    host: str
    port: int
    sender: Address
    recipients: tuple[Address, ...]
    tls: Tls = Tls.STARTTLS
    user: str | None = field(default=None, repr=False)
    password: str | None = field(default=None, repr=False)
    retries: Retries = RETRIES
    ssl_context: ssl.SSLContext | None = field(default=None, repr=False)
    """None for one that checks certificates by the system's authorities, or by SSL_CERT_FILE."""

    @property
    def name(self) -> str:
        """The server."""
        return f"e-mail through {self.host}:{self.port} ({self.tls})"

    def send(self, message: Message) -> None:
        """Send the message to all recipients.

        A message whose receipt was lost is sent again with the same Message-ID.

        Raises:
            NotTold: See `Teller.send`. Also if some of the recipients were refused.
        """
        trouble = self._deliver(letter(message, self.sender, self.recipients))
        if trouble is not None:  # raised out here, where no exception with the password in its text is at work
            raise NotTold(trouble)

    def _deliver(self, mail: EmailMessage) -> str | None:
        retry = self.retries.retry()
        while True:
            try:
                return self._refused(self._try(mail))
            except smtplib.SMTPRecipientsRefused as error:
                trouble, again = (
                    self._refused(error.recipients),
                    all(400 <= n < 500 for n, _ in error.recipients.values()),
                )
            except Exception as error:  # smtplib raises what sockets, TLS and encodings raise
                trouble, again = _explained(error)
            if not again:
                return trouble
            try:
                retry = retry.increment("SMTP", "")
            except MaxRetryError:
                return f"{trouble} (after {self.retries.tries} tries)"
            retry.sleep()

    def _try(self, mail: EmailMessage) -> dict[str, tuple[int, bytes]]:
        """Send once; returns the recipients that were refused, if not all were."""
        context = self.ssl_context or ssl.create_default_context()
        timeout = self.retries.timeout_s
        if self.tls is Tls.TLS:
            server: smtplib.SMTP = smtplib.SMTP_SSL(self.host, self.port, timeout=timeout, context=context)
        else:
            server = smtplib.SMTP(self.host, self.port, timeout=timeout)
        try:
            if self.tls is Tls.STARTTLS:
                server.starttls(context=context)
            if self.user is not None and self.password is not None:
                server.login(self.user, self.password)
            refused = server.send_message(mail)
            with contextlib.suppress(OSError):  # it is delivered, however the server takes its leave
                server.quit()
            return refused
        finally:
            server.close()

    def _refused(self, refused: dict[str, tuple[int, bytes]]) -> str | None:
        """Which recipients were refused, by their place, if any were."""
        if not refused:
            return None
        places = [str(n) for n, one in enumerate(self.recipients, 1) if one.addr_spec in refused]
        codes = sorted({code for code, _ in refused.values()})
        return (
            f"refused {len(refused)} of {len(self.recipients)} addresses with {', '.join(map(str, codes))}; "
            f"check number {', '.join(places) or '?'} in GAUNTLET_MAIL_TO"
        )


def letter(message: Message, sender: Address, recipients: tuple[Address, ...]) -> EmailMessage:
    """The message as an e-mail in plain text."""
    mail = EmailMessage()
    mail["Subject"] = f"[gauntlet] {message.title}"
    mail["From"] = sender
    mail["To"] = recipients
    mail["Date"] = formatdate()
    mail["Message-ID"] = make_msgid(domain=sender.domain)
    mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: nothing answers by itself
    mail["X-Gauntlet-Kind"] = str(message.kind)
    lines = [message.title, "", *(f"- {line}" for line in message.lines), "", *message.footer]
    mail.set_content("\n".join(lines) + "\n")
    return mail


def _explained(error: Exception) -> tuple[str, bool]:
    """What came, and what to do; and whether it may be otherwise the next time."""
    if isinstance(error, smtplib.SMTPAuthenticationError):
        again = 400 <= error.smtp_code < 500
        return f"refused to let us in ({error.smtp_code}); check GAUNTLET_SMTP_USER and GAUNTLET_SMTP_PASSWORD", again
    if isinstance(error, smtplib.SMTPSenderRefused):
        again = 400 <= error.smtp_code < 500
        return f"refused the sender ({error.smtp_code}); check GAUNTLET_MAIL_FROM, and whether it wants a user", again
    if isinstance(error, smtplib.SMTPNotSupportedError):
        return "cannot what it is asked for (STARTTLS, a login, or such addresses); check GAUNTLET_SMTP_TLS", False
    if isinstance(error, smtplib.SMTPResponseException) and error.smtp_code < 200:
        return "does not speak SMTP; check GAUNTLET_SMTP_PORT and GAUNTLET_SMTP_TLS", False
    if isinstance(error, smtplib.SMTPResponseException):
        return f"answered {error.smtp_code}; look that number up with the server's owner", error.smtp_code < 500
    if isinstance(error, smtplib.SMTPServerDisconnected):
        return "closed the connection; check GAUNTLET_SMTP_PORT and GAUNTLET_SMTP_TLS", True
    if isinstance(error, smtplib.SMTPException):
        return "offers no login that this program knows; check GAUNTLET_SMTP_USER", False
    if isinstance(error, ssl.SSLError):
        hint = "check GAUNTLET_SMTP_HOST and GAUNTLET_SMTP_TLS, or name its authority in SSL_CERT_FILE"
        return f"{what_came(error)}; {hint}", False
    return f"{what_came(error)}; check GAUNTLET_SMTP_HOST and GAUNTLET_SMTP_PORT", isinstance(error, OSError)
