"""Who may ask for what: checks before any page is made, and headers that tell browsers what a page may do."""

from __future__ import annotations

import base64
import hashlib
import hmac
import ipaddress
import re
import secrets
import threading
import time
from http.cookies import CookieError, SimpleCookie
from urllib.parse import quote, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from results.report.nights import plot

COOKIE = "gauntlet_session"
SESSION_S = 12 * 3600.0
"""How long a browser stays logged in (s)."""
SESSIONS = 1000
"""Browsers that can be logged in at once; the oldest make room."""
LOCAL = ("localhost", "127.0.0.1", "::1")
SAFE = ("GET", "HEAD", "OPTIONS")
OPEN = ("/login", "/static/")
"""Without a token: the form that asks for it, and what is the same in every installation."""


def _style_of_plots() -> str:
    """What a policy allows of inline styles: the one that `plot` puts into its pictures, and nothing else."""
    style = re.search(r"<style>(.*?)</style>", plot((), ""), re.DOTALL)
    assert style is not None
    return f"'sha256-{base64.b64encode(hashlib.sha256(style[1].encode()).digest()).decode()}'"


PAGE_POLICY = (
    f"default-src 'none'; script-src 'self'; style-src 'self' {_style_of_plots()}; img-src 'self' data:; "
    "media-src 'self'; connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": PAGE_POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
    "cache-control": "no-store",
}
"""Of every answer, unless it says otherwise itself."""


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a server that listens there."""
    try:
        return host == "localhost" or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class Sessions:
    """Browsers that are logged in. Their cookies are random and say nothing of the token."""

    def __init__(self) -> None:
        """None yet."""
        self._until: dict[bytes, float] = {}
        self._lock = threading.Lock()

    def begin(self) -> str:
        """A new session's cookie."""
        cookie = secrets.token_urlsafe(32)
        with self._lock:
            now = time.monotonic()
            self._until = {key: until for key, until in self._until.items() if until > now}
            while len(self._until) >= SESSIONS:
                del self._until[next(iter(self._until))]
            self._until[_digest(cookie)] = now + SESSION_S
        return cookie

    def end(self, cookie: str) -> None:
        """Log out."""
        with self._lock:
            self._until.pop(_digest(cookie), None)

    def knows(self, cookie: str) -> bool:
        """Whether it is one of ours, and not too old."""
        with self._lock:
            return self._until.get(_digest(cookie), 0.0) > time.monotonic()


class Guard:
    """Stands before an application and lets through what is allowed.

    On a loopback address requests must name this machine as host: else a page of another site whose name suddenly
    leads here could read everything (DNS rebinding). With a token, each request shows it or a session's cookie.
    Nothing that changes anything is taken from another site's page.
    """

    def __init__(self, app: ASGIApp, *, host: str, token: str | None, sessions: Sessions) -> None:
        """Guard `app`, which is served at `host` (a name or an address)."""
        self._app, self._token, self._sessions = app, token, sessions
        self._hosts = {*LOCAL, host.strip("[]").lower()} if is_loopback(host) else None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        headers = Headers(scope=scope)
        answer = self._refused(scope, headers) or self._unknown(scope, headers)
        await (answer or self._app)(scope, receive, send_guarded)

    def _refused(self, scope: Scope, headers: Headers) -> Response | None:
        hosts = headers.getlist("host")
        if len(hosts) != 1:
            return line("expected one Host header", 400)
        if self._hosts is not None and _name(hosts[0]) not in self._hosts:
            return line("this host name is not served here; use 127.0.0.1 or localhost", 400)
        if scope["method"] in SAFE:
            return None
        site, origin = headers.get("sec-fetch-site"), headers.get("origin")
        if site not in (None, "same-origin", "none") or (origin is not None and not _is_at(origin, hosts[0])):
            return line("refused: it comes from a page of another site", 403)
        return None

    def _unknown(self, scope: Scope, headers: Headers) -> Response | None:
        if self._token is None or scope["path"].startswith(OPEN) or self._is_known(headers):
            return None
        if scope["method"] in SAFE and "text/html" in headers.get("accept", ""):
            wanted = scope["path"] + ("?" + scope["query_string"].decode("latin-1") if scope["query_string"] else "")
            return RedirectResponse(f"/login?next={quote(wanted, safe='')}", 303)
        return line("expected the token: Authorization: Bearer TOKEN", 401, {"www-authenticate": "Bearer"})

    def _is_known(self, headers: Headers) -> bool:
        kind, _, shown = headers.get("authorization", "").partition(" ")
        if self._token is not None and kind.lower() == "bearer" and is_same(shown.strip(), self._token):
            return True
        return any(self._sessions.knows(cookie) for cookie in cookies(headers))


def cookies(headers: Headers) -> list[str]:
    """The sessions that a request claims."""
    found = []
    for header in headers.getlist("cookie"):
        try:
            parsed = SimpleCookie(header)
        except CookieError:
            continue
        found += [parsed[COOKIE].value] if COOKIE in parsed else []
    return found


def is_same(shown: str, token: str) -> bool:
    """Whether it is the token, in a time that tells nothing of it."""
    return hmac.compare_digest(shown.encode("utf-8", "replace"), token.encode("utf-8", "replace"))


def line(text: str, status: int, headers: dict[str, str] | None = None) -> PlainTextResponse:
    """An answer of one line."""
    return PlainTextResponse(" ".join(text.split()) + "\n", status, headers)


def _digest(cookie: str) -> bytes:
    return hashlib.sha256(cookie.encode("utf-8", "replace")).digest()


def _name(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _is_at(origin: str, host: str) -> bool:
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower()
