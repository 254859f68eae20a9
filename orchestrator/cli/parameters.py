"""Checks that every value of every option and argument passes before its verb sees it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import typer

from robogauntlet.suites.ranges import MAX_COUNT, MAX_FILE_NAME, MAX_NUMBER, MAX_PATH, MAX_TEXT

MEANT = {"--episodes": "--seeds", "--policies": "--policy", "--tasks": "--task"}
"""Option that there is not to the one that is meant."""
CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff\u2028\u2029]")


def check_parameters(command: Any) -> Any:
    """Return a click command, or group, that refuses values that `problem` names."""
    for below in getattr(command, "commands", {}).values():
        check_parameters(below)
    command.parse_args = partial(_parse, command, command.parse_args)
    return command


def _parse(command: Any, parse: Callable[..., Any], context: Any, arguments: list[str]) -> Any:
    """Parse a command line, check its values, and name the option that is meant by one that there is not."""
    try:
        rest = parse(context, arguments)
    except Exception as error:
        meant = MEANT.get(getattr(error, "option_name", ""))
        if meant is not None and any(meant in parameter.opts for parameter in command.params):
            error.possibilities = [meant]  # type: ignore[attr-defined]
        if hasattr(error, "message"):
            error.message = error.message.removeprefix("Value error, ")  # of pydantic
        raise
    for parameter in command.params:
        given = context.params.get(parameter.name)
        for value in given if isinstance(given, list | tuple) else [given]:
            if (wrong := problem(value)) is not None:
                raise typer.BadParameter(wrong, ctx=context, param=parameter)
    return rest


def problem(value: object) -> str | None:
    """Return what is wrong with the value of a parameter, or None."""
    if isinstance(value, int | float):
        most = MAX_COUNT if isinstance(value, int) else MAX_NUMBER
        return None if math.isfinite(value) and abs(value) <= most else f"expected at most {most:g}, got {value:g}."
    if not isinstance(value, str | Path):
        return None
    text = str(value)
    if not text.strip() or CONTROLS.search(text) is not None:
        return f"expected text in UTF-8 without control characters, got {ascii(text)[:60]}."
    if len(text) > MAX_TEXT:
        return f"expected at most {MAX_TEXT} characters, got {len(text)}."
    names = [] if isinstance(value, str) and "=" in text else text.split("/")  # NAME=VALUE is no path
    if any(len(name.encode()) > MAX_FILE_NAME for name in names) or (names and len(text.encode()) > MAX_PATH):
        return f"expected names of at most {MAX_FILE_NAME} bytes and paths of {MAX_PATH}, got {text[:40]!r}..."
    return None
