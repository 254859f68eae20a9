"""The Jinja environment of reports and of the dashboard's pages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from robogauntlet.support.text import visible

if TYPE_CHECKING:
    from jinja2 import Environment


def template_environment(*folders: Path) -> Environment:
    """Return an environment for the templates in these folders.

    Values are escaped, and their unprintable characters except line breaks are shown as escapes; an undefined name is
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


def _finalize(value: Any) -> Any:
    return visible(value, "\n\r\t") if type(value) is str else value  # Markup is escaped already
