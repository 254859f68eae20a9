"""Plug-ins declared by entry points, and suggestions for misspelt names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from difflib import SequenceMatcher, get_close_matches
from importlib import metadata
from itertools import accumulate
from typing import Any, Protocol, TypeVar

LISTED, LONGEST_LIST = 12, 250
"""Maximum number of known names in a message, and of their characters."""
MOST_HINTS = 10
CANDIDATES = 500
"""Names that are compared closely with a misspelt one."""
_hints_left: ContextVar[int | None] = ContextVar("hints_left", default=None)


class _Named(Protocol):
    @property
    def name(self) -> str: ...


Plugin = TypeVar("Plugin", bound=_Named)


@dataclass(frozen=True)
class BrokenPlugin:
    """An entry point that cannot be loaded, or has the wrong type or name."""

    name: str
    reason: str


class Plugins(Mapping[str, Plugin]):
    """The plug-ins of a group of entry points by name, without those that cannot be used.

    Each entry point must hold a `kind` whose `name` is the entry point's. Looking a name up imports that plug-in alone,
    so that a worker does not wait for the imports of all others; iterating imports all.
    """

    def __init__(self, group: str, kind: type[Plugin]) -> None:
        self._kind = kind
        self._entries: dict[str, list[metadata.EntryPoint]] = {}
        for entry in sorted(metadata.entry_points(group=group), key=lambda e: e.name):
            self._entries.setdefault(entry.name, []).append(entry)
        self._loaded: dict[str, tuple[Plugin | None, tuple[BrokenPlugin, ...]]] = {}
        """Name to its plug-in, if one of its entry points holds one, and to those that do not."""

    def __getitem__(self, name: str) -> Plugin:
        plugin = self._load(name)[0] if name in self._entries else None
        if plugin is None:
            raise KeyError(name)
        return plugin

    def __iter__(self) -> Iterator[str]:
        return (name for name in self._entries if self._load(name)[0] is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    @property
    def broken(self) -> tuple[BrokenPlugin, ...]:
        """The broken entry points."""
        return tuple(broken for name in self._entries for broken in self._load(name)[1])

    def _load(self, name: str) -> tuple[Plugin | None, tuple[BrokenPlugin, ...]]:
        if name not in self._loaded:
            found, broken = None, []
            for entry in self._entries[name]:
                try:
                    plugin = entry.load()
                except Exception as error:  # A plug-in may fail in any way, and must not affect the others.
                    reason = f"{entry.value} cannot be loaded: {type(error).__name__}: {error}"
                else:
                    reason = self._why_unusable(entry, plugin)
                if reason:
                    broken.append(BrokenPlugin(name, reason))
                else:
                    found = plugin
            self._loaded[name] = found, tuple(broken)
        return self._loaded[name]

    def _why_unusable(self, entry: metadata.EntryPoint, plugin: Any) -> str:
        if not isinstance(plugin, self._kind):
            return f"{entry.value} is a {type(plugin).__name__}, expected a {self._kind.__name__}"
        if plugin.name != entry.name:
            return f"{entry.value} is named '{plugin.name}', its entry point '{entry.name}'"
        return ""


@contextmanager
def few_hints() -> Iterator[None]:
    """Inside, `did_you_mean` answers the first ten times only: a file may have thousands of unknown names."""
    token = _hints_left.set(MOST_HINTS)
    try:
        yield
    finally:
        _hints_left.reset(token)


def did_you_mean(name: str, known: Iterable[str], *, meant: Sequence[str] = ()) -> str:
    """Return the end of a message about an unknown name: `; did you mean 'X'?`, or the known names.

    Args:
        name: The unknown name.
        known: What there is; the nearest is named.
        meant: What `name` surely means, if that is known: one name, or several to choose from.
    """
    if (left := _hints_left.get()) is not None:
        if not left:
            return ""
        _hints_left.set(left - 1)
    if len(meant) > 1:
        return f"; did you mean one of {', '.join(meant)}?"
    known = sorted(known)
    near = [*meant] or [k for k in known if "/" in name and k.startswith(f"{name}-")] or _closest(name, known)
    near = near or [k for k in known if k.split("/")[-1].startswith(name)]
    if near:
        return f"; did you mean '{near[0]}'?"
    room = accumulate(len(name) + 2 for name in known)
    listed = min(LISTED, max(1, sum(length <= LONGEST_LIST for length in room)))
    if len(known) > listed:
        return f"; known: {', '.join(known[:listed])} and {len(known) - listed} more"
    return f"; known: {', '.join(known)}" if known else "; there are none"


def _closest(name: str, known: Sequence[str]) -> list[str]:
    """The nearest of the names if it is near, as `difflib` compares them; of thousands, those with like letters."""
    if len(known) > CANDIDATES:
        matcher, likeness = SequenceMatcher(b=name), {}
        for one in known:
            matcher.set_seq1(one)
            likeness[one] = matcher.quick_ratio()
        known = sorted(known, key=lambda one: likeness[one])[-CANDIDATES:]
    return get_close_matches(name, known, 1, 0.5)
