"""Login form, style sheets and script, which are served without a token."""

from __future__ import annotations

from functools import cache
from urllib.parse import parse_qs

from fastapi import APIRouter, HTTPException, Request
from starlette.responses import RedirectResponse, Response

from robogauntlet.orchestrator.dashboard.access import SESSION_S
from robogauntlet.orchestrator.dashboard.app_state import FILES, CurrentAppState
from robogauntlet.orchestrator.dashboard.security import COOKIE, wrong_token

FORM_BYTES = 8192
TYPES = {"report.css": "text/css", "dashboard.css": "text/css", "live.js": "text/javascript"}
router = APIRouter()


@router.get("/login")
async def form(app_state: CurrentAppState, next: str = "/") -> Response:
    """Show the login form."""
    if not app_state.access.tokens:
        return RedirectResponse("/", 303)
    return app_state.page("login.html.jinja", next=_local(next), wrong=False)


@router.post("/login")
async def login(app_state: CurrentAppState, request: Request) -> Response:
    """Start a session if the token is correct."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > FORM_BYTES:
            raise HTTPException(413, f"expected a form of at most {FORM_BYTES} bytes")
    fields = parse_qs(body.decode("utf-8", "replace"))
    shown, target = fields.get("token", [""])[0].strip(), _local(fields.get("next", ["/"])[0])
    right = app_state.access.tokens.right_of(shown)
    if right is None:
        refusal = wrong_token(app_state.access, request)
        return refusal or app_state.page("login.html.jinja", status=401, next=target, wrong=True)
    public = app_state.settings.public
    answer, is_secure = RedirectResponse(target, 303), "https" in (request.url.scheme, public and public.scheme)
    cookie, age_s = app_state.access.sessions.begin(right), int(SESSION_S)
    answer.set_cookie(COOKIE, cookie, max_age=age_s, httponly=True, samesite="strict", secure=is_secure)
    return answer


@router.post("/logout")
async def logout(app_state: CurrentAppState, request: Request) -> Response:
    """End the session."""
    app_state.access.sessions.end(request.cookies.get(COOKIE, ""))
    answer = RedirectResponse("/login", 303)
    answer.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return answer


@router.get("/static/{name}")
async def static(name: str) -> Response:
    """Serve a style sheet or the script."""
    if name not in FILES:
        raise HTTPException(404, "No such file.")
    return Response(_content(name), media_type=TYPES[name], headers={"cache-control": "public, max-age=86400"})


@cache
def _content(name: str) -> bytes:
    return FILES[name].read_bytes()


def _local(address: str) -> str:
    """The address if it belongs to this site, else that of the overview."""
    plain = address.startswith("/") and not address.startswith(("//", "/\\")) and address.isprintable()
    return address if plain and "\\" not in address else "/"
