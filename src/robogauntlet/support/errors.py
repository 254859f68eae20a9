"""Bad input, and one-line descriptions of exceptions for messages to users."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Mapping
from pathlib import Path

_OS_ERRORS: Mapping[int, str] = {
    errno.ENOSPC: "the disk is full; free some space and run again",
    errno.EROFS: "the file system is read-only; choose another folder with --out",
    errno.EACCES: "no permission to write; choose another folder with --out",
    errno.EEXIST: "expected a folder, this is a file",
    errno.ENOTDIR: "expected a folder, this is a file",
}


class UserError(Exception):
    """A message for the user, one line per problem."""

    def _render_traceback_(self) -> list[str]:
        """What IPython shows in place of a traceback, which would be ours and not the user's."""
        return [f"{type(self).__name__}: {self}"]


class BadInput(UserError):
    """The command cannot be carried out as given."""


def first_line(error: BaseException | str) -> str:
    """The first line of a message that is not blank; if there is none, the exception's class name or `no message`."""
    return _lines(error)[0]


def last_line(error: BaseException | str) -> str:
    """The last line of a message that is not blank; if there is none, the exception's class name or `no message`."""
    return _lines(error)[-1]


def describe(error: BaseException) -> str:
    """`ValueError: first line of the message`, or `ValueError: no message`."""
    return f"{type(error).__name__}: {first_line(_message(error))}"


def plain_words(message: str) -> str:
    """Return a message of pydantic about a value without what only programmers know: its classes and parsers."""
    message = message.removeprefix("Value error, ")
    message = re.sub(r"a (valid )?dictionary or (an )?instance of \w+", "a mapping", message)
    return re.sub(r", (unable to (parse|interpret)|got a number with) .*", "", message)


def describe_os_error(error: BaseException) -> str:
    """The message of an exception; for errors of the operating system, with what to do."""
    if isinstance(error, OSError) and error.errno:
        return _OS_ERRORS.get(error.errno, os.strerror(error.errno))
    return str(error)


def describe_os_error_at(error: OSError, folder: Path) -> str:
    """Describe an error while a folder was written: `FOLDER: what to do`, or the failed path outside the folder."""
    place = Path(error.filename).absolute() if isinstance(error.filename, str | os.PathLike) else folder.absolute()
    if place.is_relative_to(folder.absolute()):
        return f"{folder}: {describe_os_error(error)}"
    return f"{error.filename}: {error.strerror}"


def _message(error: BaseException | str) -> str:
    try:
        return str(error)
    except Exception:  # a class of exceptions may have a faulty __str__
        return ""


def _lines(error: BaseException | str) -> list[str]:
    default = type(error).__name__ if isinstance(error, BaseException) else "no message"
    return [line.strip() for line in _message(error).splitlines() if line.strip()] or [default]
