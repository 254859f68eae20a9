"""Plug-ins declared by entry points, and suggestions for misspelt names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import metadata
from itertools import accumulate
from typing import Protocol, TypeVar

LISTED, LONGEST_LIST = 12, 250
"""Maximum number of known names in a message, and of their characters."""


class _Named(Protocol):
    @property
    def name(self) -> str: ...


Plugin = TypeVar("Plugin", bound=_Named)


@dataclass(frozen=True)
class BrokenPlugin:
    """An entry point that cannot be loaded, or has the wrong type or name."""

    name: str
    reason: str


def load_plugins(group: str, kind: type[Plugin]) -> tuple[Mapping[str, Plugin], tuple[BrokenPlugin, ...]]:
    """Return the plug-ins of a group of entry points by name, and the broken entry points.

    Each entry point must hold a `kind` whose `name` is the entry point's.
    """
    plugins: dict[str, Plugin] = {}
    broken: list[BrokenPlugin] = []
    for entry in sorted(metadata.entry_points(group=group), key=lambda e: e.name):
        reason = ""
        try:
            plugin = entry.load()
        except Exception as error:  # A plug-in may fail in any way, and must not affect the others.
            reason = f"{entry.value} cannot be loaded: {type(error).__name__}: {error}"
        else:
            if not isinstance(plugin, kind):
                reason = f"{entry.value} is a {type(plugin).__name__}, expected a {kind.__name__}"
            elif plugin.name != entry.name:
                reason = f"{entry.value} is named '{plugin.name}', its entry point '{entry.name}'"
        if reason:
            broken.append(BrokenPlugin(entry.name, reason))
        else:
            plugins[entry.name] = plugin
    return plugins, tuple(broken)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: `; did you mean 'X'?`, or the known names."""
    known = sorted(known)
    near = get_close_matches(name, known, n=1, cutoff=0.5) or [k for k in known if k.split("/")[-1].startswith(name)]
    if near:
        return f"; did you mean '{near[0]}'?"
    room = accumulate(len(name) + 2 for name in known)
    listed = min(LISTED, max(1, sum(length <= LONGEST_LIST for length in room)))
    if len(known) > listed:
        return f"; known: {', '.join(known[:listed])} and {len(known) - listed} more"
    return f"; known: {', '.join(known)}" if known else "; there are none"
