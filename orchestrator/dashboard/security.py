"""Security: tokens, sessions, and the headers that restrict pages in the browser."""

from __future__ import annotations

import base64
import hashlib
import hmac
import re
import secrets
from urllib.parse import quote

from cachetools import TTLCache
from starlette.datastructures import MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robogauntlet.results.report.history_plot import plot
from robogauntlet.support.network import is_loopback

COOKIE = "robogauntlet_session"
SESSION_S = 12 * 3600.0
"""How long a browser stays logged in (s)."""
SESSIONS = 1000
"""Largest number of sessions; the oldest end first."""
LOCAL = ("localhost", "127.0.0.1", "::1", "[::1]")
SAFE = ("GET", "HEAD", "OPTIONS")
OPEN = ("/login", "/static/")
"""Paths that need no token."""


def _style_of_plots() -> str:
    """The hash of the only inline style that pages may contain: that of `plot`."""
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
"""Headers of every answer that does not set them itself."""


class Sessions:
    """Sessions of browsers. Cookies are random and only their hashes are stored. For one thread."""

    def __init__(self) -> None:
        """Start without sessions."""
        self._known: TTLCache[bytes, bool] = TTLCache(SESSIONS, SESSION_S)

    def begin(self) -> str:
        """Start a session and return its cookie."""
        cookie = secrets.token_urlsafe(32)
        self._known[_digest(cookie)] = True
        return cookie

    def end(self, cookie: str) -> None:
        """End a session."""
        self._known.pop(_digest(cookie), None)

    def knows(self, cookie: str) -> bool:
        """Return whether a cookie belongs to a session that has not expired."""
        return _digest(cookie) in self._known


class SecurityMiddleware:
    """Checks requests before the application handles them.

    With a token, each request must carry it or the cookie of a session. Requests that change something are refused from
    pages of other sites. On a loopback address only the names of this machine are accepted, since a page of another
    site whose name resolves to this machine could otherwise read everything (DNS rebinding).
    """

    def __init__(self, app: ASGIApp, *, host: str, token: str | None, sessions: Sessions) -> None:
        """Protect `app`, which is served at `host` (a name or an address)."""
        self._token, self._sessions = token, sessions
        hosts = [*LOCAL, host.lower()] if is_loopback(host) else ["*"]
        self._app = TrustedHostMiddleware(app, allowed_hosts=hosts, www_redirect=False)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or pass it on."""
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

        answer = self._refused(Request(scope))
        await (answer or self._app)(scope, receive, send_guarded)

    def _refused(self, request: Request) -> Response | None:
        """The refusal of a request; None if it is accepted."""
        is_safe = request.method in SAFE
        site, origin = request.headers.get("sec-fetch-site"), request.headers.get("origin")
        own_origins = [f"{scheme}://{request.headers.get('host', '')}".lower() for scheme in ("http", "https")]
        if not is_safe and (
            site not in (None, "same-origin", "none") or (origin is not None and origin.lower() not in own_origins)
        ):
            return line("refused: the request comes from a page of another site", 403)
        if self._token is None or request.url.path.startswith(OPEN) or self._is_known(request, self._token):
            return None
        if is_safe and "text/html" in request.headers.get("accept", ""):
            wanted = request.url.path + (f"?{request.url.query}" if request.url.query else "")
            return RedirectResponse(f"/login?next={quote(wanted, safe='')}", 303)
        return line("expected the token: Authorization: Bearer TOKEN", 401, {"www-authenticate": "Bearer"})

    def _is_known(self, request: Request, token: str) -> bool:
        kind, _, shown = request.headers.get("authorization", "").partition(" ")
        is_bearer = kind.lower() == "bearer" and tokens_match(shown.strip(), token)
        return is_bearer or self._sessions.knows(request.cookies.get(COOKIE, ""))


def tokens_match(shown: str, token: str) -> bool:
    """Compare a token in constant time."""
    return hmac.compare_digest(shown.encode("utf-8", "replace"), token.encode("utf-8", "replace"))


def line(text: str, status: int, headers: dict[str, str] | None = None) -> PlainTextResponse:
    """Return an answer of one line."""
    return PlainTextResponse(" ".join(text.split()) + "\n", status, headers)


def _digest(cookie: str) -> bytes:
    return hashlib.sha256(cookie.encode("utf-8", "replace")).digest()
