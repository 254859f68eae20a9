"""Puts what depends on the machine out of texts: last digits of floats, the place of files, the version."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from typing import Any

from robogauntlet import __version__

DIGITS = 9
"""Significant digits of a float: the last ones differ between processors."""
WIDTH = 120
SENTENCES = ("p", "li", "figcaption", "summary")
"""Elements of a page that hold sentences."""


def rounded(value: Any) -> Any:
    """JSON with floats of `DIGITS` significant digits."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {name: rounded(one) for name, one in value.items()}
    return [rounded(one) for one in value] if isinstance(value, list) else value


def json_text(value: Any) -> str:
    """JSON with a line for each part that fits into one."""
    return "\n".join(_lines(rounded(value), "")) + "\n"


def _lines(value: Any, indent: str) -> list[str]:
    whole = json.dumps(value, ensure_ascii=False)
    if len(indent + whole) <= WIDTH or not isinstance(value, dict | list) or not value:
        return [indent + whole]
    opening, closing = ("{", "}") if isinstance(value, dict) else ("[", "]")
    parts = value.items() if isinstance(value, dict) else [(None, one) for one in value]
    lines = [indent + opening]
    for name, one in parts:
        inner = _lines(one, indent + " ")
        if name is not None:
            inner[0] = f"{indent} {json.dumps(name)}: {inner[0].lstrip()}"
        inner[-1] += ","
        lines += inner
    lines[-1] = lines[-1].removesuffix(",")
    return [*lines, indent + closing]


def plain(text: str, place: str) -> str:
    """Text without the place of files, the version and blanks at the ends of lines; JSON as `json_text`."""
    text = text.replace(place, "PLACE").replace(__version__, "VERSION")
    try:
        return json_text(json.loads(text))
    except ValueError:
        lines = (line.rstrip() for line in text.splitlines())
        return "\n".join(lines).strip("\n") + "\n"


class _Sentences(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self._depth = 0

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag in SENTENCES:
            self._depth += 1
            self.found.append("")

    def handle_endtag(self, tag: str) -> None:
        if tag in SENTENCES:
            self._depth -= 1

    def handle_data(self, data: str) -> None:
        if self._depth > 0:
            self.found[-1] += data


def page_sentences(html: str, known: str) -> str:
    """Sentences of a page that are not in `known`, a line each."""
    parser = _Sentences()
    parser.feed(html)
    letters = re.compile(r"[^A-Za-z]+")
    beside = letters.sub("", known)
    texts = dict.fromkeys(" ".join(text.split()) for text in parser.found)
    return "".join(f"{text}\n" for text in texts if text and letters.sub("", text) not in beside)
