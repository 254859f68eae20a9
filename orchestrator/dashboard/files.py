"""Files of a run folder: the report's and what was filmed, and no others."""

from __future__ import annotations

import re
from pathlib import Path

from fastapi import APIRouter, HTTPException
from starlette.responses import FileResponse, Response

from orchestrator.dashboard import queries
from orchestrator.dashboard.desk import TheDesk
from results.media import MEDIA

QUIET = "sandbox; default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'"
LIVELY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; "
    "img-src data: blob:; style-src 'unsafe-inline'; frame-ancestors 'none'"
)
"""The page with plots draws them by its own scripts; in a sandbox they are of no site, and reach none."""
KINDS = {
    "report.html": "text/html; charset=utf-8",
    "explore.html": "text/html; charset=utf-8",
    "report.md": "text/plain; charset=utf-8",
    "summary.json": "application/json",
    "cells.csv": "text/csv; charset=utf-8",
}
MEDIUM = re.compile(rf"{MEDIA}/(?:[A-Za-z0-9_-]+/)*[A-Za-z0-9_.@ -]+\.(png|mp4)")
MEDIA_KINDS = {"png": "image/png", "mp4": "video/mp4"}
router = APIRouter()


@router.get("/runs/{run_id}/files/{path:path}")
def file_of_run(desk: TheDesk, run_id: str, path: str) -> Response:
    """A file of a run. Reports are shown in a sandbox: what they say comes from whoever made the run."""
    entry = queries.run_of(desk.history, run_id)
    found = None if entry is None or entry.folder is None else known_file(Path(entry.folder), path)
    if found is None:
        raise HTTPException(404, "This run has no such file.")
    policy = LIVELY if path == "explore.html" else QUIET
    return FileResponse(found, media_type=kind_of(path), headers={"content-security-policy": policy})


def kind_of(path: str) -> str | None:
    """The media type of a file that may be shown; None for all others."""
    medium = MEDIUM.fullmatch(path)
    return MEDIA_KINDS[medium[1]] if medium else KINDS.get(path)


def known_file(folder: Path, path: str) -> Path | None:
    """Where a file of a run folder lies; None if it is not one that may be shown, or lies elsewhere.

    Args:
        folder: The run folder.
        path: Within the folder, as someone asked for it.
    """
    if kind_of(path) is None or ".." in path.split("/"):
        return None
    try:
        home = folder.resolve(strict=True)
        found = (home / path).resolve(strict=True)
    except (OSError, RuntimeError, ValueError):
        return None
    if not found.is_relative_to(home) or not found.is_file():
        return None
    return found if kind_of(found.relative_to(home).as_posix()) == kind_of(path) else None
