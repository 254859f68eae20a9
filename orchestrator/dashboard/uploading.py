"""Takes exported runs in: `curl --data-binary @NAME.gauntlet http://127.0.0.1:8770/runs`."""

from __future__ import annotations

import re
import secrets
import shutil
import threading
from pathlib import Path
from urllib.parse import quote

from fastapi import APIRouter, HTTPException, Request
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import PlainTextResponse, Response

from orchestrator.dashboard import queries
from orchestrator.dashboard.desk import Desk, TheDesk, log
from results.carrying import import_run
from results.database import StoreError
from results.report import write_report
from results.run import RunDocument, RunError
from results.syncing import take_in_run

PIECE = 1 << 20
AT_ONCE = 2
"""Uploads under way; each may take its limit of disk space."""
RUN_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
router = APIRouter()
_places = threading.BoundedSemaphore(AT_ONCE)


@router.post("/runs")
async def upload(desk: TheDesk, request: Request) -> Response:
    """Make a run folder of an exported run, the body of the request, and tell the history of it."""
    limit = desk.settings.max_upload
    if int(request.headers.get("content-length", "0") or 0) > limit:
        raise HTTPException(413, _too_large(limit))
    if not _places.acquire(blocking=False):
        raise HTTPException(503, f"{AT_ONCE} uploads are under way; try again in a while")
    try:
        desk.settings.root.mkdir(parents=True, exist_ok=True)
        file = desk.settings.root / f".upload-{secrets.token_hex(8)}"
        try:
            await _receive(request, file, limit)
            folder, document = await run_in_threadpool(_put, desk, file)
        finally:
            file.unlink(missing_ok=True)
    except ClientDisconnect:
        return Response(status_code=400)  # nobody reads it
    except OSError as error:
        log.warning("an upload was not kept: %s", error)
        raise HTTPException(503, f"the run could not be kept: {error.strerror}") from None
    finally:
        _places.release()
    address = f"/runs/{quote(document.run_id, safe='')}"
    task = BackgroundTask(_report, folder)
    return PlainTextResponse(f"{address}\n", 201, {"location": address}, background=task)


async def _receive(request: Request, file: Path, limit: int) -> None:
    """Write the body into a file. Raises HTTPException: it is larger than it may be."""
    size, pieces = 0, bytearray()
    with file.open("xb") as opened:
        async for chunk in request.stream():
            size += len(chunk)
            if size > 2 * limit:  # whoever sends reads the answer only when all is sent, so a little more is let in
                break
            if size > limit:
                pieces.clear()
                continue
            pieces += chunk
            if len(pieces) >= PIECE:
                await run_in_threadpool(opened.write, bytes(pieces))
                pieces.clear()
        opened.write(pieces)
    if size > limit:
        raise HTTPException(413, _too_large(limit))
    if not size:
        raise HTTPException(400, "expected an exported run (gauntlet export) as the body, got nothing")


def _put(desk: Desk, file: Path) -> tuple[Path, RunDocument]:
    """Raises HTTPException: it is no run, or here already; StoreError: the history cannot be written."""

    def check(document: RunDocument) -> None:
        if not RUN_ID.fullmatch(document.run_id):
            raise RunError("its run id is none that this program gives")
        if document.store_url is not None:
            raise RunError("it says that its rows are elsewhere")
        if queries.run_of(desk.history, document.run_id) is not None:
            raise HTTPException(409, f"run {document.run_id} is here already")

    with desk.taking_in:
        try:
            folder, document = import_run(file, desk.settings.root, check=check)
        except (RunError, StoreError) as error:
            raise HTTPException(400, _in_their_words(str(error), desk.settings.root, file)) from None
        try:
            take_in_run(desk.history, folder, document)
        except StoreError:
            shutil.rmtree(folder, ignore_errors=True)
            raise
    return folder, document


def _in_their_words(message: str, root: Path, file: Path) -> str:
    """What is wrong with what was sent, without where it was kept here."""
    said = message.removeprefix("sqlite:///").replace(str(file), "the body")
    for place in (root.absolute(), root):
        said = said.replace(f"{place}/", "")
    return said if "exported run" in said else f"expected an exported run (gauntlet export): {said}"


def _report(folder: Path) -> None:
    try:
        write_report(folder)
    except (RunError, StoreError, OSError) as error:
        log.warning("%s: no report was written: %s", folder, error)


def _too_large(limit: int) -> str:
    return f"expected at most {limit / 1024 / 1024:,.0f} MB (gauntlet serve --max-upload-mb)"
