"""Verbs that other distributions add, by entry points of the group `robogauntlet.verbs`. Imports none of them."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

GROUP = "[robogauntlet.verbs]\n"


@cache
def plugin_verbs() -> Mapping[str, tuple[str, str]]:
    """Return each verb's function or group (`module:name`), and the summary of its distribution as its help.

    The files are read here since importlib.metadata would add a quarter to the time of `robogauntlet --help`.
    """
    found: dict[str, tuple[str, str]] = {}
    for folder, text in _declaring():
        metadata = (folder / "METADATA").read_text(encoding="utf-8")
        summary = re.search(r"^Summary: (.*)$", metadata, re.MULTILINE)
        for line in text.partition(GROUP)[2].partition("\n[")[0].splitlines():
            name, sign, address = line.partition("=")
            if sign:
                found.setdefault(name.strip(), (address.strip(), summary[1] if summary else ""))
    return found


def _declaring() -> Iterator[tuple[Path, str]]:
    """The folders with the metadata of distributions that add verbs, and their entry points."""
    for place in sys.path:
        try:
            names = os.listdir(place or ".")  # noqa: PTH208  thousands of names, of which few are wanted
        except OSError:
            continue
        for name in sorted(names):
            if name.endswith(".dist-info"):
                folder = Path(place) / name
                try:
                    text = (folder / "entry_points.txt").read_text(encoding="utf-8")
                except (OSError, ValueError):
                    continue
                if GROUP in text:
                    yield folder, text
