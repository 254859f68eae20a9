"""The files of a run folder that are served: those of the report, images and videos."""

from __future__ import annotations

import re
from pathlib import Path

from fastapi import APIRouter, HTTPException
from starlette.responses import FileResponse, Response

from robogauntlet.orchestrator.dashboard import queries
from robogauntlet.orchestrator.dashboard.app_state import CurrentAppState
from robogauntlet.results.media_paths import MEDIA
from robogauntlet.results.report.templates import table_script

POLICY = (
    f"sandbox allow-scripts; default-src 'none'; script-src {table_script().source}; img-src data:; media-src data:; "
    "style-src 'unsafe-inline'; frame-ancestors 'none'"
)
"""Only the script of the report's tables runs; the sandbox gives it no origin and no network."""
REPORT_TYPES = {
    "report.html": "text/html; charset=utf-8",
    "report.md": "text/plain; charset=utf-8",
    "summary.json": "application/json",
    "cells.csv": "text/csv; charset=utf-8",
}
MEDIA_PATTERN = re.compile(rf"{MEDIA}/(?:[A-Za-z0-9_-]+/)*[A-Za-z0-9_.@ -]+\.(png|mp4)")
MEDIA_TYPES = {"png": "image/png", "mp4": "video/mp4"}
router = APIRouter()


@router.get("/runs/{run_id}/files/{path:path}")
def file_of_run(app_state: CurrentAppState, run_id: str, path: str) -> Response:
    """Serve a file of a run. Reports are shown in a sandbox, since whoever made the run controls their content."""
    entry = queries.run_of(app_state.history, run_id)
    file = None if entry is None or entry.folder is None else known_file(Path(entry.folder), path)
    if file is None:
        raise HTTPException(404, "The run has no such file.")
    return FileResponse(file, media_type=media_type(path), headers={"content-security-policy": POLICY})


def media_type(path: str) -> str | None:
    """Return the media type of a file that may be served; None for all others."""
    match = MEDIA_PATTERN.fullmatch(path)
    return MEDIA_TYPES[match[1]] if match else REPORT_TYPES.get(path)


def known_file(folder: Path, path: str) -> Path | None:
    """Return the file at a requested path in a run folder; None if it may not be served or is outside of the folder."""
    if media_type(path) is None or ".." in path.split("/"):
        return None
    try:
        root = folder.resolve(strict=True)
        file = (root / path).resolve(strict=True)
    except (OSError, RuntimeError, ValueError):
        return None
    if not file.is_relative_to(root) or not file.is_file():
        return None
    return file if media_type(file.relative_to(root).as_posix()) == media_type(path) else None
