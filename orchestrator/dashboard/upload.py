"""Receives exported runs: `curl --data-binary @NAME.robogauntlet http://127.0.0.1:8770/runs`."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from anyio import to_thread
from fastapi import APIRouter, HTTPException, Request
from starlette.background import BackgroundTask
from starlette.requests import ClientDisconnect
from starlette.responses import PlainTextResponse, Response

from robogauntlet.orchestrator.dashboard import queries
from robogauntlet.orchestrator.dashboard.app_state import AppState, CurrentAppState, log
from robogauntlet.results.report import write_report
from robogauntlet.results.run_document import RunDocument, RunError
from robogauntlet.results.store.arriving import arriving_folder
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_archive import discard, import_run
from robogauntlet.support.text import visible

router = APIRouter()


@router.post("/runs")
async def upload(app_state: CurrentAppState, request: Request) -> Response:
    """Create a run folder from the exported run in the body, and record it in the history."""
    limit = app_state.settings.max_upload
    announced = int(request.headers.get("content-length") or limit)
    if announced > limit:
        raise HTTPException(413, _too_large(limit))
    try:
        async with app_state.uploads.place(announced) as place:
            with arriving_folder(app_state.settings.root) as arriving:
                file = arriving / "body"
                place.size = await _receive(request, file, limit)
                folder, document = await to_thread.run_sync(_import, app_state, file, limiter=app_state.imports)
    except ClientDisconnect:
        return Response(status_code=400)  # the client has gone
    except OSError as error:
        log.warning("an upload was not stored: %s", error)
        raise HTTPException(503, f"the run could not be stored: {error.strerror}") from None
    address = f"/runs/{quote(document.run_id, safe='')}"
    sender = request.client.host if request.client else "unknown"
    log.info("run %s of suite %s was uploaded from %s", document.run_id, visible(document.suite.name[:80]), sender)
    task = BackgroundTask(_report, app_state, folder)
    return PlainTextResponse(f"{address}\n", 201, {"location": address}, background=task)


async def _receive(request: Request, file: Path, limit: int) -> int:
    """Write the body into a file and return its size. Raises HTTPException if it is too large or empty."""
    size = 0
    with file.open("xb") as opened:
        async for chunk in request.stream():
            size += len(chunk)
            if size <= limit:
                opened.write(chunk)
            elif size > 2 * limit:  # read some more, since clients read the answer only after sending
                break
    if size > limit:
        raise HTTPException(413, _too_large(limit))
    if not size:
        raise HTTPException(400, "expected an exported run (robogauntlet export) as the body, got nothing")
    return size


def _import(app_state: AppState, file: Path) -> tuple[Path, RunDocument]:
    """Import the run. Raises HTTPException if it is not a run or exists already, StoreError."""

    def check(document: RunDocument) -> None:
        if document.store_url is not None:
            raise RunError("its rows are in another store")
        if queries.run_of(app_state.history, document.run_id) is not None:
            raise HTTPException(409, f"run {document.run_id} exists already")

    with app_state.import_lock:
        try:
            folder, document = import_run(file, app_state.settings.root, check=check)
        except (RunError, StoreError) as error:
            if error.__cause__ is not None:  # how the process ended that read it
                log.warning("an upload was refused: %s", visible(str(error.__cause__)[:200]))
            raise HTTPException(400, _public_message(str(error), app_state.settings.root, file)) from None
        except (HTTPException, OSError):
            raise
        except Exception as error:  # whatever the sender's file provokes is the file's mistake
            log.warning("an upload was refused: %s: %s", type(error).__name__, visible(str(error)[:200]))
            raise HTTPException(400, "expected an exported run (robogauntlet export): it cannot be read") from None
        try:
            record_run_folder(app_state.history, folder, document)
        except BaseException:
            discard(folder, document, None)
            raise
    return folder, document


def _public_message(message: str, root: Path, file: Path) -> str:
    """The message without paths of this machine."""
    public = message.removeprefix("sqlite:///").replace(str(file), "the body")
    for place in (root.absolute(), root):
        public = public.replace(f"{place}/", "")
    return public if "exported run" in public else f"expected an exported run (robogauntlet export): {public}"


async def _report(app_state: AppState, folder: Path) -> None:
    try:
        await to_thread.run_sync(write_report, folder, limiter=app_state.reports)
    except Exception as error:  # whatever the sender's run provokes, it has no report
        log.warning("%s: no report was written: %s", folder, error)


def _too_large(limit: int) -> str:
    return f"expected at most {limit / 1024 / 1024:,.0f} MB (robogauntlet serve --max-upload-mb)"
