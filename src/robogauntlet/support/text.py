"""Texts for people: numbers with their nouns, and texts of others, made safe to show."""

from __future__ import annotations

from collections.abc import Sequence


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """`1 episode`, `1,200 episodes`; `plural` of a noun that does not only take an s."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def first_of(names: Sequence[str], limit: int = 3) -> str:
    """`a, b, c and 12 more`: the first names of many."""
    more = f" and {len(names) - limit:,} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more


def visible(text: str, keep: str = "") -> str:
    """Return a text whose unprintable characters are shown as escapes: control characters, marks of direction.

    A terminal would carry them out, and a page would show the words around them in another order. Characters in `keep`
    stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else ascii(c)[1:-1] for c in text)


def shortened(text: str, limit: int) -> str:
    """Return a text of at most `limit` characters: a longer one without its middle, since its end may hold a hint."""
    half = (limit - 5) // 2
    return text if len(text) <= limit else f"{text[:half]} ... {text[-half:]}"
