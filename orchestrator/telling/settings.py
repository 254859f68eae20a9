"""Who is told, from the environment: secrets stand nowhere else."""

from __future__ import annotations

import ipaddress
import ssl
from collections.abc import Mapping
from email.errors import MessageError
from email.headerregistry import Address
from email.utils import getaddresses
from urllib.parse import urlsplit

import requests

from orchestrator.telling.mail import PORTS, Mail, Tls
from orchestrator.telling.teller import RETRIES, Retries, Teller, TellingError
from orchestrator.telling.webhook import VARIABLE, Webhook

NEEDED = ("GAUNTLET_SMTP_HOST", "GAUNTLET_MAIL_FROM", "GAUNTLET_MAIL_TO")
LOGIN = ("GAUNTLET_SMTP_USER", "GAUNTLET_SMTP_PASSWORD")
OTHERS = ("GAUNTLET_SMTP_PORT", "GAUNTLET_SMTP_TLS")


def tellers(
    environment: Mapping[str, str], *, retries: Retries = RETRIES, ssl_context: ssl.SSLContext | None = None
) -> list[Teller]:
    """The tellers that the environment names: a webhook per address, and one e-mail. Nothing is connected to.

    Args:
        environment: Such as `os.environ`; see docs/telling.md. A variable that is empty is as one that is not there.
        retries: How often to try.
        ssl_context: For e-mail; None for one that checks certificates by the system's authorities.

    Returns:
        None of them if no variable is set.

    Raises:
        TellingError: A variable is missing or malformed.
    """
    problems: list[str] = []
    given = {name: value for name, value in environment.items() if name.startswith("GAUNTLET_") and value.strip()}
    found: list[Teller] = [*_webhooks(given.get(VARIABLE, "").split(), retries, problems)]
    if any(name in given for name in (*NEEDED, *LOGIN, *OTHERS)):
        mail = _mail(given, retries, ssl_context, problems)
        found += [mail] if mail is not None else []
    if problems:
        raise TellingError("\n".join(problems))
    return found


def _webhooks(urls: list[str], retries: Retries, problems: list[str]) -> list[Webhook]:
    found = []
    for number, url in enumerate(urls, 1):
        place = f"webhook {number} of {len(urls)}" if len(urls) > 1 else "webhook"
        host = _host(url)
        if host is None:
            which = f", address {number} of {len(urls)}" if len(urls) > 1 else ""
            problems.append(f"{VARIABLE}{which}: expected https://HOST/..., got something else")
        else:
            found.append(Webhook(f"{place} ({host})", url, retries))
    return found


def _host(url: str) -> str | None:
    """Scheme and host of an address to which something can be posted, or None."""
    try:
        parts = urlsplit(url)
        if parts.scheme.lower() not in ("http", "https") or not parts.hostname or "@" in parts.netloc:
            return None  # with a name and a password before the host, a part of them could be taken for the host
        requests.Request("POST", url, json={}).prepare()
        if not url.isascii() or not url.isprintable() or "\\" in parts.netloc or parts.port == 0:
            return None
    except (ValueError, requests.RequestException):
        return None
    return f"{parts.scheme.lower()}://{parts.hostname}"


def _mail(
    given: Mapping[str, str], retries: Retries, context: ssl.SSLContext | None, problems: list[str]
) -> Mail | None:
    before = len(problems)
    problems += [f"{name}: not set, and an e-mail needs it" for name in NEEDED if name not in given]
    for name, other in (LOGIN, LOGIN[::-1]):
        if name not in given and other in given:
            problems.append(f"{name}: not set, and {other} is")
        if not given.get(name, "").isascii():
            problems.append(f"{name}: expected ASCII, as SMTP logins are")
    tls = _tls(given, problems)
    host = given.get("GAUNTLET_SMTP_HOST", "").strip()
    if not host.isprintable() or any(sign in host for sign in " /@"):
        problems.append("GAUNTLET_SMTP_HOST: expected the name of a host, got something else")
    elif tls is Tls.NONE and host and not _is_loopback(host):
        problems.append(
            "GAUNTLET_SMTP_TLS: none is for a server on this machine (localhost); expected starttls or tls for another"
        )
    port = _port(given, tls, problems)
    sender = _addresses(given, "GAUNTLET_MAIL_FROM", problems)
    recipients = _addresses(given, "GAUNTLET_MAIL_TO", problems)
    if len(sender) > 1:
        problems.append(f"GAUNTLET_MAIL_FROM: expected one address, got {len(sender)}")
    if len(problems) > before or tls is None:
        return None
    user, password = (given.get(name) for name in LOGIN)
    return Mail(host, port, sender[0], tuple(recipients), tls, user, password, retries, context)


def _tls(given: Mapping[str, str], problems: list[str]) -> Tls | None:
    word = given.get("GAUNTLET_SMTP_TLS", Tls.STARTTLS).strip().lower()
    if word in list(Tls):
        return Tls(word)
    problems.append(f"GAUNTLET_SMTP_TLS: expected {', '.join(Tls)}, got another word")
    return None


def _port(given: Mapping[str, str], tls: Tls | None, problems: list[str]) -> int:
    text = given.get("GAUNTLET_SMTP_PORT", str(PORTS[tls or Tls.STARTTLS])).strip()
    if text.isascii() and text.isdigit() and len(text) < 6 and 0 < int(text) < 65536:
        return int(text)
    problems.append("GAUNTLET_SMTP_PORT: expected a number from 1 to 65535, got something else")
    return 0


def _addresses(given: Mapping[str, str], name: str, problems: list[str]) -> list[Address]:
    """The addresses of a variable, separated by commas, with or without names: `Lab <lab@example.org>`."""
    text = given.get(name)
    if text is None:
        return []
    plain = text.strip().rstrip(",")
    found = [_address(shown, spec) for shown, spec in getaddresses([plain])] if plain.isprintable() else [None]
    known = [one for one in found if one is not None]
    if len(known) < len(found):
        problems.append(f"{name}: expected e-mail addresses separated by commas, got something else")
        return []
    return known


def _address(shown: str, spec: str) -> Address | None:
    user, _, domain = spec.rpartition("@")
    if not user or not domain or any(sign.isspace() for sign in spec):
        return None
    try:
        return Address(shown, addr_spec=spec)
    except (ValueError, IndexError, MessageError):  # which headerregistry raises, as it finds them
        return None


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"
