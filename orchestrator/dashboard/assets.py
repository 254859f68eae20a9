"""The style sheets and the script: the same in every installation, so they are given to anyone."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from results.report import page as report_page

HERE = Path(__file__).parent
FILES = {
    "report.css": report_page.HERE / "report.css",
    "dashboard.css": HERE / "static" / "dashboard.css",
    "live.js": HERE / "static" / "live.js",
}


@cache
def address(name: str) -> str:
    """Where a file is served; another address for another content, so that a browser may keep it."""
    return f"/static/{name}?v={hashlib.sha256(FILES[name].read_bytes()).hexdigest()[:12]}"
