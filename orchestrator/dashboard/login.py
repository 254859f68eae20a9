"""The form that asks for the token, the style and the scripts: what is served to anyone."""

from __future__ import annotations

from urllib.parse import parse_qs

from fastapi import APIRouter, HTTPException, Request
from starlette.responses import FileResponse, RedirectResponse, Response

from orchestrator.dashboard.assets import FILES
from orchestrator.dashboard.desk import TheDesk
from orchestrator.dashboard.guard import COOKIE, SESSION_S, cookies, is_same

FORM_BYTES = 8192
router = APIRouter()


@router.get("/login")
def form(desk: TheDesk, next: str = "/") -> Response:
    """Ask for the token."""
    if desk.settings.token is None:
        return RedirectResponse("/", 303)
    return desk.page("login.html.jinja", next=_local(next), wrong=False)


@router.post("/login")
async def login(desk: TheDesk, request: Request) -> Response:
    """Begin a session if the token is right."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > FORM_BYTES:
            raise HTTPException(413, "expected a form with a token, this is larger")
    fields = parse_qs(body.decode("utf-8", "replace"))
    shown, there = fields.get("token", [""])[0].strip(), _local(fields.get("next", ["/"])[0])
    if desk.settings.token is None or not is_same(shown, desk.settings.token):
        return desk.page("login.html.jinja", status=401, next=there, wrong=True)
    answer = RedirectResponse(there, 303)
    answer.set_cookie(
        COOKIE,
        desk.sessions.begin(),
        max_age=int(SESSION_S),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )
    return answer


@router.post("/logout")
def logout(desk: TheDesk, request: Request) -> Response:
    """End the session."""
    for cookie in cookies(request.headers):
        desk.sessions.end(cookie)
    answer = RedirectResponse("/login", 303)
    answer.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return answer


@router.get("/static/{name}")
def static(name: str) -> Response:
    """A style or a script."""
    if name not in FILES:
        raise HTTPException(404, "There is no such file.")
    return FileResponse(FILES[name], headers={"cache-control": "public, max-age=86400"})


def _local(address: str) -> str:
    """The address if it is one of this site, else the overview."""
    plain = address.startswith("/") and not address.startswith(("//", "/\\")) and address.isprintable()
    return address if plain and "\\" not in address else "/"
