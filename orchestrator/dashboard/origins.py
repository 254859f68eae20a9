"""Origins of pages, and the public address of a dashboard behind a proxy."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlsplit

DEFAULT_PORTS = {"http": 80, "https": 443}


@dataclass(frozen=True)
class Origin:
    """Scheme, host name in small letters, and port, which is the scheme's own if the address names none."""

    scheme: str
    host: str
    port: int

    def __str__(self) -> str:
        """`https://lab.example.org`, without the scheme's own port."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}" + ("" if self.port == DEFAULT_PORTS[self.scheme] else f":{self.port}")


def origin_of(text: str) -> Origin | None:
    """Return the origin that is written as `https://HOST:PORT`; None if it is none."""
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        return None
    is_plain = text.isprintable() and not any(sign in text for sign in "@\\ ")
    if parts.scheme not in DEFAULT_PORTS or not host or not is_plain or parts.path or parts.query or parts.fragment:
        return None
    return Origin(parts.scheme, host.lower(), DEFAULT_PORTS[parts.scheme] if port is None else port)
