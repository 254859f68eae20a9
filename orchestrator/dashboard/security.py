"""Which requests are accepted, and the headers that restrict pages in the browser."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import logging
from contextlib import suppress
from urllib.parse import quote, urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robogauntlet.support.network import is_loopback
from robogauntlet.support.text import visible

log = logging.getLogger("robogauntlet.dashboard")
COOKIE = "robogauntlet"
LOCAL = ("localhost", "127.0.0.1", "::1")
OPEN = ("/login", "/static/")
"""Paths that need no token."""
BEARER = {"www-authenticate": "Bearer"}


HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; media-src 'self'; connect-src 'self'; form-action 'self'; base-uri 'none'; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
    "cache-control": "no-store",
}
"""Headers of every answer that does not set them itself."""


class Guard:
    """Checks requests before the application handles them.

    With a token, each request must carry it, or the cookie that the login sets. On a loopback address only the names of
    this machine and the public name are accepted, since a page of another site whose name resolves to this machine
    could otherwise read everything (DNS rebinding).
    """

    def __init__(self, app: ASGIApp, *, host: str, public_host: str | None, token: str | None) -> None:
        """Protect `app`, which is served at `host` (a name or an address) and known as `public_host`."""
        self._app, self._token = app, token
        self._hosts = {*LOCAL, host.lower(), (public_host or host).lower()} if is_loopback(host) else None

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

        request = Request(scope)
        answer = None if self._token is None else self._refusal(request, self._token)
        if answer is None and self._hosts is not None and host_of(request) not in self._hosts:
            answer = line("Invalid host header", 400)
        try:
            await (answer or self._app)(scope, receive, send_guarded)
        except asyncio.CancelledError:  # the server stops and waits no longer
            with suppress(RuntimeError):  # the answer has begun
                await line("The server was stopped.", 503)(scope, receive, send_guarded)

    def _refusal(self, request: Request, token: str) -> Response | None:
        kind, _, shown = request.headers.get("authorization", "").partition(" ")
        shown = shown.strip() if kind.lower() == "bearer" else ""
        is_logged_in = is_same(request.cookies.get(COOKIE, ""), cookie_of(token))
        if is_same(shown, token) or is_logged_in or request.url.path.startswith(OPEN):
            return None
        if shown:
            log_wrong_token(request)
            return line("wrong token", 401, BEARER)
        if "text/html" in request.headers.get("accept", ""):
            wanted = request.url.path + (f"?{request.url.query}" if request.url.query else "")
            return RedirectResponse(f"/login?next={quote(wanted, safe='')}", 303)
        return line("expected the token: Authorization: Bearer TOKEN", 401, BEARER)


def host_of(request: Request) -> str | None:
    """The name or address in a request's Host header, None if that has more or less than a host and a port.

    Starlette's own middleware takes no address of IPv6 in versions that are allowed here.
    """
    shown = request.headers.get("host", "")
    try:
        parts = urlsplit(f"//{shown}")
        _ = parts.port  # raises for one that is none
    except ValueError:
        return None
    return parts.hostname if parts.netloc == shown and "@" not in shown else None


def is_same(shown: str, expected: str) -> bool:
    """Compare secrets in constant time."""
    return hmac.compare_digest(shown.encode("utf-8", "replace"), expected.encode("utf-8", "replace"))


def cookie_of(token: str) -> str:
    """Return the cookie of browsers that have shown the token, from which the token cannot be computed."""
    return hmac.new(token.encode(), b"cookie of the dashboard", hashlib.sha256).hexdigest()


def log_wrong_token(request: Request) -> None:
    """Log the address and the path of a request with a wrong token."""
    address = request.client.host if request.client else "unknown"
    log.warning("wrong token from %s for %s", address, visible(request.url.path[:80]))


def line(text: str, status: int, headers: dict[str, str] | None = None) -> PlainTextResponse:
    """Return an answer of one line."""
    return PlainTextResponse(" ".join(text.split()) + "\n", status, headers)
