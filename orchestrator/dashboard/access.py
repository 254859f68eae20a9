"""Who may do what: tokens, sessions of browsers, and addresses that sent wrong tokens."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from enum import IntEnum

from cachetools import TTLCache

SESSION_S = 12 * 3600.0
"""How long a browser stays logged in (s)."""
SESSIONS = 1000
"""Largest number of sessions; the oldest end first."""
ATTEMPTS = 5
"""Wrong tokens of an address before it is paused."""
PAUSE_S = 60.0
"""How long an address is paused after its last counted attempt (s)."""
ADDRESSES = 10_000
"""Addresses whose wrong tokens are counted."""


class Right(IntEnum):
    """What a token allows; the larger includes the smaller."""

    READ = 1
    CHANGE = 2


class Tokens:
    """The tokens of a dashboard; without a token everybody may do everything."""

    def __init__(self, token: str | None, read_token: str | None) -> None:
        """Accept `token` for everything and `read_token` for reading; None if there is none."""
        self._rights = [(known, right) for known, right in ((token, Right.CHANGE), (read_token, Right.READ)) if known]

    def __bool__(self) -> bool:
        """Whether a token is needed."""
        return bool(self._rights)

    def right_of(self, shown: str) -> Right | None:
        """Return what a token allows, None if it is wrong. The time does not depend on it."""
        found = [right for known, right in self._rights if tokens_match(shown, known)]
        return max(found, default=None)


class Sessions:
    """Sessions of browsers. Cookies are random and only their hashes are stored. For one thread."""

    def __init__(self) -> None:
        """Start without sessions."""
        self._known: TTLCache[bytes, Right] = TTLCache(SESSIONS, SESSION_S)

    def begin(self, right: Right) -> str:
        """Start a session with these rights and return its cookie."""
        cookie = secrets.token_urlsafe(32)
        self._known[_digest(cookie)] = right
        return cookie

    def end(self, cookie: str) -> None:
        """End a session."""
        self._known.pop(_digest(cookie), None)

    def right_of(self, cookie: str) -> Right | None:
        """Return the rights of a session; None if there is none or it has expired."""
        return self._known.get(_digest(cookie))


class WrongTokens:
    """Counts wrong tokens by address. For one thread."""

    def __init__(self, pause_s: float = PAUSE_S) -> None:
        """Pause an address for `pause_s` seconds after `ATTEMPTS` wrong tokens."""
        self._counts: TTLCache[str, int] = TTLCache(ADDRESSES, pause_s)

    def is_paused(self, address: str) -> bool:
        """Return whether the address has had its attempts."""
        return self._counts.get(address, 0) >= ATTEMPTS

    def count(self, address: str) -> int:
        """Count a wrong token of an address; return the attempts that it has left."""
        self._counts[address] = self._counts.get(address, 0) + 1
        return ATTEMPTS - self._counts[address]


class Access:
    """Who may do what on a dashboard."""

    def __init__(self, token: str | None, read_token: str | None = None) -> None:
        """Start without sessions; for the tokens see `Tokens`."""
        self.tokens, self.sessions, self.wrong = Tokens(token, read_token), Sessions(), WrongTokens()


def tokens_match(shown: str, token: str) -> bool:
    """Compare a token in constant time."""
    return hmac.compare_digest(shown.encode("utf-8", "replace"), token.encode("utf-8", "replace"))


def _digest(cookie: str) -> bytes:
    return hashlib.sha256(cookie.encode("utf-8", "replace")).digest()
