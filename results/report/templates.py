"""The Jinja environment of reports and of the dashboard's pages."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robogauntlet.support.text import visible

if TYPE_CHECKING:
    from jinja2 import Environment


def template_environment(*folders: Path) -> Environment:
    """Return an environment for the templates in these folders.

    Values are escaped, and their unprintable characters except line breaks are shown as escapes. An undefined name is
    an error.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(folders),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_finalize,
    )


@cache
def report_templates() -> Environment:
    """Return the environment of the report's pages, whose templates are compiled once in a process."""
    return template_environment(Path(__file__).parent)


@dataclass(frozen=True, slots=True)
class Script:
    """The script of a page, and the source of its Content-Security-Policy that lets this script run and no other."""

    text: str
    source: str


@cache
def table_script() -> Script:
    """Return the script that sorts and filters the report's tables."""
    text = (Path(__file__).parent / "tables.js").read_text(encoding="utf-8")
    return Script(text, f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'")


def _finalize(value: Any) -> Any:
    return visible(value, "\n\r\t") if type(value) is str else value  # Markup is escaped already
