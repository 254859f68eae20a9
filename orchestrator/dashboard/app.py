"""The application: its parts, and what is answered when something is wrong."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import cast

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp

from orchestrator.calendar.book import Book
from orchestrator.calendar.schedule import ScheduleError
from orchestrator.dashboard import comparing, failures, files, login, metrics, pages, runs, uploading
from orchestrator.dashboard.desk import Desk, Settings, log
from orchestrator.dashboard.guard import Guard, line
from results.database import StoreError
from results.history import History
from results.run import RunError

FOR_PROGRAMS = ("/metrics", "/healthz")


def create_app(history: History, book: Book, settings: Settings) -> ASGIApp:
    """The dashboard as an ASGI application.

    Args:
        history: The runs; stays open for as long as the application is used.
        book: The schedules; the same.
        settings: How it is served.
    """
    desk = Desk(history, book, settings)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        desk.begin()
        yield
        desk.end()

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, lifespan=lifespan, redirect_slashes=False)
    app.state.desk = desk
    for part in (pages, runs, comparing, failures, files, login, metrics, uploading):
        app.include_router(part.router)
    for kind in (StoreError, RunError, ScheduleError, HTTPException, RequestValidationError, Exception):
        app.add_exception_handler(kind, _explain)
    return Guard(app, host=settings.host, token=settings.token, sessions=desk.sessions)


def _explain(request: Request, error: Exception) -> Response:
    """One line to whoever asked, in the form they asked for; what happened inside is for the log."""
    if isinstance(error, HTTPException):
        status, message = error.status_code, str(error.detail)
    elif isinstance(error, RequestValidationError):
        first = error.errors()[0]
        status, message = 400, f"{'.'.join(map(str, first['loc'][1:]))}: {first['msg']}"
    elif isinstance(error, StoreError | RunError | ScheduleError):
        status, message = 503, str(error)
        log.warning("%s: %s", request.url.path, error)
    else:
        status, message = 500, "The server's log says what happened."
    if request.url.path.startswith("/api/"):
        return JSONResponse({"error": message}, status)
    if request.method == "POST" or request.url.path in FOR_PROGRAMS:
        return line(message, status)
    return cast(Desk, request.app.state.desk).trouble(message, status)
