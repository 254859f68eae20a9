"""Finding things by name: what entry points declare, and the name that a misspelt one was meant to be."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import metadata
from typing import Protocol, TypeVar

LISTED = 12
"""Known names that a message lists at most."""


class _Named(Protocol):
    @property
    def name(self) -> str: ...


Plugin = TypeVar("Plugin", bound=_Named)


@dataclass(frozen=True)
class BrokenPlugin:
    """An entry point that could not be loaded, or holds something else than its group promises."""

    name: str
    reason: str


def load_plugins(group: str, kind: type[Plugin]) -> tuple[Mapping[str, Plugin], tuple[BrokenPlugin, ...]]:
    """What the entry points of a group declare, by name, and those that are broken.

    Args:
        group: Name of the group.
        kind: What each entry point must hold; its `name` must be the entry point's.
    """
    plugins: dict[str, Plugin] = {}
    broken: list[BrokenPlugin] = []
    for entry in sorted(metadata.entry_points(group=group), key=lambda e: e.name):
        try:
            plugin = entry.load()
        except Exception as error:  # a plug-in may fail in any way, and must not take the others along
            reason = f"{entry.value} cannot be loaded: {type(error).__name__}: {error}"
            broken.append(BrokenPlugin(entry.name, reason))
            continue
        if not isinstance(plugin, kind):
            reason = f"{entry.value} is a {type(plugin).__name__}, expected a {kind.__name__}"
            broken.append(BrokenPlugin(entry.name, reason))
        elif plugin.name != entry.name:
            reason = f"{entry.value} calls itself '{plugin.name}', its entry point '{entry.name}'"
            broken.append(BrokenPlugin(entry.name, reason))
        else:
            plugins[entry.name] = plugin
    return plugins, tuple(broken)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: `; did you mean 'X'?`, or what there is."""
    known = sorted(known)
    near = get_close_matches(name, known, n=1, cutoff=0.5) or [k for k in known if k.split("/")[-1].startswith(name)]
    if near:
        return f"; did you mean '{near[0]}'?"
    if len(known) > LISTED:
        return f"; known: {', '.join(known[:LISTED])} and {len(known) - LISTED} more"
    return f"; known: {', '.join(known)}" if known else "; there are none"
