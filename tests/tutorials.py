"""Pages of the documentation that tests follow: the files and commands in their blocks."""

import re

from tests import ROOT

BLOCK = re.compile(
    r'^```(?:\w+ title="(?P<path>[^"]+)"|(?P<console>console))\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL
)


def blocks(page):
    """The blocks of `docs/PAGE.md` in order: a file's path and text, or None and the lines of commands."""
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    return [(block["path"], block["text"]) for block in BLOCK.finditer(text)]
