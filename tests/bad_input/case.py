"""A bad input: a command line, the files that it needs, and what the answer says."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field

from tests.bad_input.folder import Content

SECRET = "hunter2-hunter2-hunter2"
"""A password that no answer may show."""
ODD = {
    "{nul}": "a\0b",
    "{newline}": "a\nb",
    "{escape}": "a\x1b[31mb",
    "{surrogate}": "a\udcffb",
    "{long}": "x" * 20_000,
    "{name300}": "x" * 300,
    "{path5000}": "/".join(["x" * 200] * 25),
    "{arabic}": "٣",
    "{empty}": "",
    "{blank}": "  ",
    "{secret}": SECRET,
}
"""Texts that a case names, since a table cannot show them."""


@dataclass(frozen=True)
class Case:
    """A command line that is refused."""

    typed: str
    """What is typed after `robogauntlet`, as for a shell, with names of `ODD`."""
    says: str
    """A part of the answer, or of each of its lines, if it names several mistakes."""
    files: Mapping[str, Content] = field(default_factory=dict)
    """Files that are written before, beside those of `folder.py`."""
    variables: Mapping[str, str] = field(default_factory=dict)
    """Environment variables."""
    code: int = 2

    @property
    def arguments(self) -> list[str]:
        """The command line, taken apart."""
        parts = shlex.split(self.typed)
        for name, text in ODD.items():
            parts = [part.replace(name, text) for part in parts]
        return parts


def table(*rows: tuple[str, str]) -> list[Case]:
    """Cases that need no files of their own."""
    return [Case(*row) for row in rows]
