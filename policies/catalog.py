"""Which kinds of policies there are. Fed by entry points of the group `robogauntlet.policies`; loads no weights."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from policies.contract import Policy, PolicyError, PolicyKind, PolicySpec
from suites.plugins import BrokenPlugin, load_plugins, nearest

GROUP = "robogauntlet.policies"


@cache
def _load() -> tuple[Mapping[str, PolicyKind], tuple[BrokenPlugin, ...]]:
    return load_plugins(GROUP, PolicyKind)


def kinds() -> Mapping[str, PolicyKind]:
    """Every kind of policy by name."""
    return _load()[0]


def broken_plugins() -> tuple[BrokenPlugin, ...]:
    """Entry points that declare no usable policy."""
    return _load()[1]


def find(kind: str) -> PolicyKind:
    """The kind of that name.

    Raises:
        PolicyError: There is none.
    """
    known = kinds()
    if kind not in known:
        raise PolicyError(f"unknown policy '{kind}'{nearest(kind, known)}")
    return known[kind]


def load(kind: str, options: Mapping[str, Any]) -> Policy:
    """Build a policy.

    Raises:
        PolicyError: Unknown kind, or options that do not fit.
    """
    return find(kind).load(options)


def spec(kind: str, options: Mapping[str, Any]) -> PolicySpec:
    """What a policy needs and produces.

    Raises:
        PolicyError: Unknown kind, or options that do not fit.
    """
    found = find(kind)
    return found.spec(options) if found.spec is not None else found.load(options).spec


def digest(kind: str, options: Mapping[str, Any]) -> str:
    """Hash of a policy's content.

    Raises:
        PolicyError: Unknown kind, or options that do not fit.
    """
    return find(kind).digest(options)
