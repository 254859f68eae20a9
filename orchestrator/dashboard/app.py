"""The application: its routers and its answers to errors."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import cast

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp

from robogauntlet.orchestrator.dashboard import compare, failures, files, login, metrics, pages, runs
from robogauntlet.orchestrator.dashboard.app_state import AppState, Settings, log
from robogauntlet.orchestrator.dashboard.security import Guard, line
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.run_history import History

CONNECTIONS = 500
"""Most connections at a time; more are answered with 503."""
PLAIN_TEXT_PATHS = ("/metrics", "/healthz")


def create_app(history: History, schedule_store: ScheduleStore, settings: Settings) -> ASGIApp:
    """Create the dashboard as an ASGI application. Both stores must stay open while it is used."""
    app_state = AppState(history, schedule_store, settings)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        app_state.begin()
        yield
        app_state.end()

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, lifespan=lifespan, redirect_slashes=False)
    app.state.app_state = app_state
    for module in (pages, runs, compare, failures, files, login, metrics):
        app.include_router(module.router)
    for kind in (StoreError, RunError, HTTPException, RequestValidationError, Exception):
        app.add_exception_handler(kind, _explain)
    return Guard(app, host=settings.host, public_host=settings.public_host, token=settings.token)


def server_of(app: ASGIApp) -> uvicorn.Server:
    """Return the server of the dashboard."""
    return uvicorn.Server(
        uvicorn.Config(
            app,
            limit_concurrency=CONNECTIONS,
            log_level="warning",
            access_log=False,
            server_header=False,
            ws="none",
            timeout_graceful_shutdown=3,
        )
    )


def _explain(request: Request, error: Exception) -> Response:
    """Answer with one line in the format of the request; details go into the log."""
    headers: Mapping[str, str] = {}
    if isinstance(error, HTTPException):
        status, message, headers = error.status_code, str(error.detail), error.headers or {}
    elif isinstance(error, RequestValidationError):
        first = error.errors()[0]
        status, message = 400, f"{'.'.join(map(str, first['loc'][1:]))}: {first['msg']}"
    elif isinstance(error, StoreError | RunError):
        status, message = 503, str(error)
        log.warning("%s: %s", request.url.path, error)
    else:
        status, message = 500, "An internal error; see the log of the server."
    if request.url.path.startswith("/api/"):
        answer: Response = JSONResponse({"error": message}, status)
    elif request.method == "POST" or request.url.path in PLAIN_TEXT_PATHS:
        answer = line(message, status)
    else:
        answer = cast(AppState, request.app.state.app_state).error_page(message, status)
    answer.headers.update(headers)
    return answer
