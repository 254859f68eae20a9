"""Files that a command writes where its user says. None takes the place of a file that such a command did not write."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from robogauntlet.support.errors import BadInput
from robogauntlet.support.files import RefusedFile, open_regular, write_whole

HEAD = 16_384
"""Bytes by which a file is recognised."""


@dataclass(frozen=True)
class Output:
    """A kind of file that a command writes."""

    what: str
    """In messages: "a comparison"."""
    begins: re.Pattern[bytes]
    """How every file of this kind begins, and hardly any other."""

    def check(self, file: Path) -> None:
        """Raise BadInput unless there is no file, an empty one, or an earlier one of this kind."""
        try:
            with open_regular(file) as existing:
                head = existing.read(HEAD)
        except RefusedFile as error:
            raise BadInput(f"{file}: expected a file to write, this is {error}") from None
        except (FileNotFoundError, NotADirectoryError):
            if not file.parent.is_dir():
                raise BadInput(f"{file}: expected a file in an existing folder") from None
            return
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise BadInput(f"{file}: cannot be written: {reason}") from None
        if head and not self.begins.match(head):
            raise BadInput(
                f"{file}: expected a new file, or {self.what} to replace, this is another file; name a new one"
            )

    def write(self, file: Path, content: str | bytes) -> None:
        """Write a file (text as UTF-8) as a whole. Raises BadInput as `check`, or if it cannot be written."""
        self.check(file)
        try:
            write_whole(file, content)
        except OSError as error:
            raise BadInput(f"{file}: cannot be written: {error.strerror}") from None
