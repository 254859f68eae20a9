"""Checks that every argument of every verb passes before the verb sees it: characters, length, range."""

from __future__ import annotations

import inspect
import math
import re
import typing
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import typer

from robogauntlet.suites.ranges import MAX_COUNT, MAX_FILE_NAME, MAX_NUMBER, MAX_PATH, MAX_TEXT
from robogauntlet.support.errors import plain_words

WHOLE = re.compile(r"[+-]?[0-9]+")
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
MEANT = {"--episodes": "--seeds", "--policies": "--policy", "--tasks": "--task"}
"""Option that there is not to the one that is meant."""
CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff\u2028\u2029]")


def check_parameters(command: Any) -> Any:
    """Return a click command, or group, whose parameters refuse values that `problem` names."""
    for below in getattr(command, "commands", {}).values():
        check_parameters(below)
    kinds = typing.get_type_hints(inspect.unwrap(command.callback)) if command.callback else {}
    command.parse_args = partial(_parse, command, command.parse_args)
    for parameter in command.params:
        kind = kinds.get(parameter.name, str)  # --help is none of the function's
        while arguments := typing.get_args(kind):  # those of `int | None` and `list[Path]`
            kind = arguments[0]
        parameter.process_value = partial(_check_and_process, parameter, parameter.process_value, kind)
    return command


def _parse(command: Any, parse: Callable[..., Any], context: Any, arguments: list[str]) -> Any:
    """Parse a command line, and name the option that is meant by one that there is not."""
    try:
        return parse(context, arguments)
    except typer.BadParameter:
        raise
    except Exception as error:
        meant = MEANT.get(getattr(error, "option_name", ""))
        if meant is not None and any(meant in parameter.opts for parameter in command.params):
            error.possibilities = [meant]  # type: ignore[attr-defined]
        raise


def problem(kind: type, value: str) -> str | None:
    """Return what is wrong with an argument, or None.

    Args:
        kind: Its type: `int`, `float`, `Path`, `str` or an enumeration.
        value: The argument as it was typed.
    """
    if not value.strip():
        return "expected a value, got an empty one."
    if (wrong := CONTROLS.search(value)) is not None:
        return f"expected text in UTF-8 without control characters, got U+{ord(wrong[0]):04X}."
    if kind is int:
        digits = value.strip().lstrip("+-")
        if not WHOLE.fullmatch(value.strip()):
            return f"{_shown(value)} is not a valid integer."
        return None if len(digits) < 20 and int(digits) <= MAX_COUNT else f"expected at most {MAX_COUNT} in magnitude."
    if kind is float:
        number = float(value) if NUMBER.fullmatch(value.strip()) else math.nan
        if math.isnan(number):
            return f"{_shown(value)} is not a valid number."
        return None if abs(number) <= MAX_NUMBER else f"expected at most {MAX_NUMBER:g} in magnitude."
    if len(value) > MAX_TEXT:
        return f"expected at most {MAX_TEXT} characters, got {len(value)}."
    if kind is Path or "=" not in value:  # a text may be a path, NAME=VALUE is none
        longest = max(len(part.encode()) for part in value.split("/"))
        if longest > MAX_FILE_NAME or len(value.encode()) > MAX_PATH:
            return f"expected names of at most {MAX_FILE_NAME} bytes and paths of {MAX_PATH}, got {_shown(value)}."
    return None


def _check_and_process(parameter: Any, process: Callable[..., Any], kind: type, context: Any, value: Any) -> Any:
    """Refuse what `problem` names, then process a parameter's value, or values, as click does."""
    for given in value if isinstance(value, list | tuple) else [value]:
        plain = isinstance(given, str | int | float) and not isinstance(given, bool)
        if plain and (message := problem(kind, str(given))) is not None:
            raise typer.BadParameter(message, ctx=context, param=parameter)
    try:
        processed = process(context, value)
        return _through_folders_that_exist(processed) if isinstance(processed, Path) else processed
    except typer.BadParameter as error:
        error.message = _in_our_words(error.message, value)
        raise


def _through_folders_that_exist(path: Path) -> Path:
    """Return a path without `missing/..`: the folder would be made on the way to another one."""
    steps = (Path(*path.parts[:i]) for i, part in enumerate(path.parts) if part == "..")
    return path.resolve() if any(not step.exists() for step in steps) else path


def _in_our_words(message: str, value: Any) -> str:
    """Return a message of typer about a value, which does not say what was given, as those of `problem` say it."""
    text = plain_words(message).rstrip(".")
    if not text:
        return ""  # what is missing is said by whoever shows the message
    if "Input should be" not in text:
        return f"{text}."
    expected = text.replace("Input should be a ", "expected a ").replace("Input should be", "expected a value")
    return f"{expected}, got {value if isinstance(value, int | float) else _shown(str(value))}."


def _shown(value: str) -> str:
    return repr(value if len(value) <= 40 else f"{value[:40]}...")
