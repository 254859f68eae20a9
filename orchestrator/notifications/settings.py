"""Reads the targets of notifications from environment variables; secrets are not stored elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from email.errors import MessageError
from email.headerregistry import Address
from email.utils import getaddresses
from urllib.parse import urlsplit

from robogauntlet.orchestrator.notifications.sending import Mail, Notifier, Tls, Webhook
from robogauntlet.support.errors import BadInput
from robogauntlet.support.network import is_loopback

WEBHOOK = "ROBOGAUNTLET_WEBHOOK_URL"
NEEDED = ("ROBOGAUNTLET_SMTP_HOST", "ROBOGAUNTLET_MAIL_FROM", "ROBOGAUNTLET_MAIL_TO")
LOGIN = ("ROBOGAUNTLET_SMTP_USER", "ROBOGAUNTLET_SMTP_PASSWORD")
OTHERS = ("ROBOGAUNTLET_SMTP_PORT", "ROBOGAUNTLET_SMTP_TLS")
PORTS = {Tls.STARTTLS: "587", Tls.TLS: "465", Tls.NONE: "25"}


class NotificationError(BadInput):
    """Variables are missing or malformed. The message has a line per problem, with names but without values."""


def notifiers(environment: Mapping[str, str]) -> list[Notifier]:
    """Return the targets of notifications: a webhook per address, and e-mail. Opens no connection.

    Args:
        environment: Variables such as `os.environ`; see docs/operating.md. Empty variables count as unset.

    Raises:
        NotificationError: A variable is missing or malformed.
    """
    problems: list[str] = []
    given = {name: value for name, value in environment.items() if value.strip()}
    targets: list[Notifier] = []
    urls = given.get(WEBHOOK, "").split()
    for number, url in enumerate(urls, 1):
        place = f" {number} of {len(urls)}" if len(urls) > 1 else ""
        host = _host(url)
        if host is None:
            problems.append(f"{WEBHOOK}: expected https://HOST/..., got something else{place and f' as number{place}'}")
        else:
            targets.append(Webhook(f"webhook{place} ({host})", url))
    if any(name in given for name in (*NEEDED, *LOGIN, *OTHERS)):
        mail = _mail(given, problems)
        targets += [mail] if mail is not None else []
    if problems:
        raise NotificationError("\n".join(problems))
    return targets


def _host(url: str) -> str | None:
    """Scheme and host of a web address; None if it is invalid or contains a login, which could look like a host."""
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError:
        return None
    if not usable or not url.isascii() or not url.isprintable() or any(sign in parts.netloc for sign in "@\\"):
        return None
    return f"{parts.scheme}://{parts.hostname}"


def _mail(given: Mapping[str, str], problems: list[str]) -> Mail | None:
    before = len(problems)
    problems += [f"{name}: not set, but e-mail needs it" for name in NEEDED if name not in given]
    for name, other in (LOGIN, LOGIN[::-1]):
        if name not in given and other in given:
            problems.append(f"{name}: not set, but {other} is")
    tls = given.get("ROBOGAUNTLET_SMTP_TLS", Tls.STARTTLS).strip().lower()
    host = given.get("ROBOGAUNTLET_SMTP_HOST", "").strip()
    port = given.get("ROBOGAUNTLET_SMTP_PORT", PORTS.get(tls, "25")).strip()  # type: ignore[call-overload]
    if tls not in list(Tls):
        problems.append(f"ROBOGAUNTLET_SMTP_TLS: expected {', '.join(Tls)}, got something else")
    if not host.isprintable() or any(sign in host for sign in " /@"):
        problems.append("ROBOGAUNTLET_SMTP_HOST: expected the name of a host, got something else")
    elif tls == Tls.NONE and host and not is_loopback(host):
        local = "none is for a server on this machine (localhost)"
        problems.append(f"ROBOGAUNTLET_SMTP_TLS: {local}; expected starttls or tls for another")
    if not (port.isascii() and port.isdigit() and len(port) < 6 and 0 < int(port) < 65536):
        problems.append("ROBOGAUNTLET_SMTP_PORT: expected a number from 1 to 65535, got something else")
    sender = _addresses(given, "ROBOGAUNTLET_MAIL_FROM", problems)
    recipients = _addresses(given, "ROBOGAUNTLET_MAIL_TO", problems)
    if len(sender) > 1:
        problems.append(f"ROBOGAUNTLET_MAIL_FROM: expected one address, got {len(sender)}")
    if len(problems) > before:
        return None
    return Mail(host, int(port), sender[0], tuple(recipients), Tls(tls), *map(given.get, LOGIN))


def _addresses(given: Mapping[str, str], name: str, problems: list[str]) -> list[Address]:
    """Parse comma-separated addresses, with or without names: `Lab <lab@example.org>`."""
    text = given.get(name, "").strip().rstrip(",")
    try:
        addresses = [Address(name, addr_spec=spec) for name, spec in getaddresses([text])] if text else []
    except (ValueError, IndexError, MessageError):  # raised by headerregistry
        addresses = [Address()]
    if not text.isprintable() or not all(address.username and address.domain for address in addresses):
        problems.append(f"{name}: expected e-mail addresses separated by commas, got something else")
        return []
    return addresses
