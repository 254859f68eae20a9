"""Login form, style sheets and script, which are served without a token."""

from __future__ import annotations

from functools import cache
from urllib.parse import parse_qs

from fastapi import APIRouter, HTTPException, Request
from starlette.responses import RedirectResponse, Response

from robogauntlet.orchestrator.dashboard.app_state import FILES, CurrentAppState
from robogauntlet.orchestrator.dashboard.security import COOKIE, cookie_of, is_same, log_wrong_token

FORM_BYTES = 8192
TYPES = {"report.css": "text/css", "dashboard.css": "text/css", "live.js": "text/javascript"}
router = APIRouter()


@router.get("/login")
def form(app_state: CurrentAppState, next: str = "/") -> Response:
    """Show the login form."""
    if app_state.settings.token is None:
        return RedirectResponse("/", 303)
    return app_state.page("login.html.jinja", next=_local(next), wrong=False)


@router.post("/login")
async def login(app_state: CurrentAppState, request: Request) -> Response:
    """Give the browser its cookie if the token is right. Nothing changes here."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > FORM_BYTES:
            raise HTTPException(413, f"expected a form of at most {FORM_BYTES} bytes")
    fields, token = parse_qs(body.decode("utf-8", "replace")), app_state.settings.token
    target = _local(fields.get("next", ["/"])[0])
    if token is None or not is_same(fields.get("token", [""])[0].strip(), token):
        log_wrong_token(request)
        return app_state.page("login.html.jinja", status=401, next=target, wrong=True)
    answer, is_secure = RedirectResponse(target, 303), app_state.settings.is_https or request.url.scheme == "https"
    answer.set_cookie(COOKIE, cookie_of(token), httponly=True, samesite="strict", secure=is_secure)
    return answer


@router.get("/static/{name}")
def static(name: str) -> Response:
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
