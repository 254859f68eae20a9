"""Which kinds of policies there are. Fed by entry points of the group `robogauntlet.policies`; loads no weights."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from importlib import metadata
from typing import Any

from policies.contract import Policy, PolicyError, PolicyKind

GROUP = "robogauntlet.policies"


@cache
def _load() -> tuple[Mapping[str, PolicyKind], tuple[str, ...]]:
    kinds: dict[str, PolicyKind] = {}
    broken: list[str] = []
    for entry in sorted(metadata.entry_points(group=GROUP), key=lambda e: e.name):
        try:
            kind = entry.load()
        except Exception as error:  # a plug-in may fail in any way, and must not take the others along
            broken.append(f"{entry.name}: {entry.value} cannot be loaded: {type(error).__name__}: {error}")
            continue
        if not isinstance(kind, PolicyKind) or kind.name != entry.name:
            broken.append(f"{entry.name}: {entry.value} is not a policies.contract.PolicyKind of that name")
        else:
            kinds[entry.name] = kind
    return kinds, tuple(broken)


def kinds() -> Mapping[str, PolicyKind]:
    """Every kind of policy by name."""
    return _load()[0]


def broken_plugins() -> tuple[str, ...]:
    """Entry points that declare no usable policy, a line each."""
    return _load()[1]


def find(kind: str) -> PolicyKind:
    """The kind of that name.

    Raises:
        PolicyError: There is none.
    """
    known = kinds()
    if kind not in known:
        near = get_close_matches(kind, known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
        raise PolicyError(f"unknown policy '{kind}'; {hint}")
    return known[kind]


def load(kind: str, options: Mapping[str, Any]) -> Policy:
    """Build a policy.

    Raises:
        PolicyError: Unknown kind, or options that do not fit.
    """
    return find(kind).load(options)


def digest(kind: str, options: Mapping[str, Any]) -> str:
    """Hash of a policy's content.

    Raises:
        PolicyError: Unknown kind, or options that do not fit.
    """
    return find(kind).digest(options)
