"""JSON, and its numbers, of files and processes that may be anybody's."""

from __future__ import annotations

import json
import reprlib
from typing import Any


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text. Raises ValueError, where `json.loads` may raise RecursionError too."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("lists and objects are nested too deeply") from None


def whole_number(value: object, lowest: int, highest: int) -> int:
    """Return a value of a JSON text that is a whole number of this range; 7.0 is one, true is none.

    Raises ValueError for anything else, with a message such as `expected a whole number from 1 to 100, got null`.
    """
    if isinstance(value, int | float) and not isinstance(value, bool) and lowest <= value <= highest:
        number = int(value)
        if number == value:
            return number
    raise ValueError(f"expected a whole number from {lowest:,} to {highest:,}, got {_shown(value)}")


def _shown(value: object) -> str:
    """A value as JSON, shortened before it is written: a list may be long and an integer have a million digits."""
    if value is None or isinstance(value, bool | float):
        return json.dumps(value)
    return reprlib.repr(value)
