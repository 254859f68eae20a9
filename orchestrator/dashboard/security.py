"""Security: which requests are accepted, and the headers that restrict pages in the browser."""

from __future__ import annotations

import base64
import hashlib
import logging
import re
from urllib.parse import quote

from starlette.datastructures import MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robogauntlet.orchestrator.dashboard.access import PAUSE_S, Access, Right
from robogauntlet.orchestrator.dashboard.origins import DEFAULT_PORTS, Origin, origin_of
from robogauntlet.results.report.history_plot import plot
from robogauntlet.support.network import is_loopback
from robogauntlet.support.text import visible

log = logging.getLogger("robogauntlet.dashboard")
COOKIE = "robogauntlet_session"
LOCAL = ("localhost", "127.0.0.1", "::1", "[::1]")
SAFE = ("GET", "HEAD", "OPTIONS")
OPEN = ("/login", "/static/")
"""Paths that need no token."""
FOR_READERS = ("/logout",)
"""Paths that change something and need no more than the right to read."""
BEARER = {"www-authenticate": "Bearer"}


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


class SecurityMiddleware:
    """Checks requests before the application handles them.

    With a token, each request must carry it or the cookie of a session. Requests that change something are refused from
    pages of other sites. On a loopback address only the names of this machine and the public name are accepted, since a
    page of another site whose name resolves to this machine could otherwise read everything (DNS rebinding).
    """

    def __init__(self, app: ASGIApp, *, host: str, public: Origin | None, access: Access) -> None:
        """Protect `app`, which is served at `host` (a name or an address) and known as `public`."""
        self._access, self._public = access, public
        names = () if public is None else (public.host, f"[{public.host}]")
        hosts = [*LOCAL, host.lower(), *names] if is_loopback(host) else ["*"]
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
        if not is_safe and not self._is_own_page(request):
            return line("refused: the request comes from a page of another site", 403)
        if not self._access.tokens or request.url.path.startswith(OPEN):
            return None
        right = self._right_of(request)
        if right is not None:
            is_allowed = is_safe or right is Right.CHANGE or request.url.path in FOR_READERS
            return None if is_allowed else line("refused: this token is for reading only", 403)
        kind, _, shown = request.headers.get("authorization", "").partition(" ")
        if kind.lower() == "bearer" and shown.strip():
            return wrong_token(self._access, request) or line("wrong token", 401, BEARER)
        if is_safe and "text/html" in request.headers.get("accept", ""):
            wanted = request.url.path + (f"?{request.url.query}" if request.url.query else "")
            return RedirectResponse(f"/login?next={quote(wanted, safe='')}", 303)
        return line("expected the token: Authorization: Bearer TOKEN", 401, BEARER)

    def _right_of(self, request: Request) -> Right | None:
        kind, _, shown = request.headers.get("authorization", "").partition(" ")
        right = self._access.tokens.right_of(shown.strip()) if kind.lower() == "bearer" else None
        return right or self._access.sessions.right_of(request.cookies.get(COOKIE, ""))

    def _is_own_page(self, request: Request) -> bool:
        """Whether the request comes from a page of this dashboard, or from no page."""
        if request.headers.get("sec-fetch-site") not in (None, "same-origin", "none"):
            return False
        origin, host = request.headers.get("origin"), request.headers.get("host", "")
        if origin is None:
            return True
        own = {origin_of(f"{scheme}://{host}") for scheme in DEFAULT_PORTS}
        return origin_of(origin.lower()) in {*own, self._public} - {None}


def wrong_token(access: Access, request: Request) -> Response | None:
    """Count and log a wrong token; return the refusal of an address that is paused, else None."""
    address = request.client.host if request.client else "unknown"
    if not access.wrong.is_paused(address):
        left = access.wrong.count(address)
        log.warning("wrong token from %s for %s%s", address, visible(request.url.path[:80]), "" if left else "; paused")
        return None
    answer = f"too many wrong tokens from {address}: wait {PAUSE_S:.0f} s"
    return line(answer, 429, {"retry-after": f"{PAUSE_S:.0f}"})


def line(text: str, status: int, headers: dict[str, str] | None = None) -> PlainTextResponse:
    """Return an answer of one line."""
    return PlainTextResponse(" ".join(text.split()) + "\n", status, headers)
