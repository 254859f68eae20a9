"""What a parser says of bad texts."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

SECRET = "hunter2-hunter2-hunter2"
"""A password that no answer may show."""
LONGEST_LINE = 500
"""Characters of a line of an answer."""


def differences(answer: str, says: str) -> Iterator[str]:
    """How an answer differs from what is expected of it: a line for each of `says`, with that in it."""
    lines, expected = answer.splitlines(), says.splitlines()
    if len(lines) != len(expected) or not all(part in line for part, line in zip(expected, lines, strict=True)):
        yield f"expected {says!r}, got {answer!r}"
    if SECRET in answer:
        yield f"a password is shown: {answer!r}"
    if any(len(line) > LONGEST_LINE for line in lines):
        yield f"a line of {max(map(len, lines))} characters: {answer[:100]!r}"


def not_refused(parse: Callable[[Any], object], texts: Mapping[Any, str], errors: Any) -> list[str]:
    """Parse each text, and return the ones that are not refused with a line for each of what the table says."""
    found: list[str] = []
    for text, says in texts.items():
        try:
            parse(text)
        except errors as error:
            found += (f"{text!r:.200}: {difference}" for difference in differences(str(error), says))
        else:
            found.append(f"{text!r:.200}: not refused")
    return found
