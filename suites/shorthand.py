"""Short forms of a suite's policies: `oracle`, `openpi://HOST:PORT`, `python:module:Name`."""

from __future__ import annotations

import re
from typing import Any

SHORT = {"openpi": "address", "python": "callable", "lerobot": "checkpoint"}
"""Kind to the option that may stand behind it and a colon."""
LONGEST_NAME = 80


def policy_entry(text: str) -> dict[str, Any]:
    """The entry that a text stands for: a kind, or a kind with its one option and a name made of both."""
    kind, colon, rest = text.partition(":")
    if not colon or kind not in SHORT or not rest:
        return {"name": text, "kind": text}
    value = text if rest.startswith("//") else rest
    name = re.sub(r"[^A-Za-z0-9._]+", "-", text).strip("-._")[:LONGEST_NAME]
    return {"name": name, "kind": kind, "options": {SHORT[kind]: value}}
