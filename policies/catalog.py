"""The catalog of policy kinds, from entry points of the group `robogauntlet.policies`. Loads no weights."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from robogauntlet.policies.contract import Policy, PolicyError, PolicyKind, PolicySpec, Wishes
from robogauntlet.suites.plugins import BrokenPlugin, Plugins, did_you_mean

GROUP = "robogauntlet.policies"


@cache
def _load() -> Plugins[PolicyKind]:
    return Plugins(GROUP, PolicyKind)


def kinds() -> Mapping[str, PolicyKind]:
    """Return every policy kind by name."""
    return _load()


def broken_plugins() -> tuple[BrokenPlugin, ...]:
    """Return the entry points that declare no usable policy."""
    return _load().broken


def find(kind: str) -> PolicyKind:
    """Return the kind of that name. Raises PolicyError for an unknown one."""
    known = kinds()
    if kind not in known:
        raise PolicyError(f"unknown policy '{kind}'{did_you_mean(kind, known)}")
    return known[kind]


def load(kind: str, options: Mapping[str, Any]) -> Policy:
    """Build a policy. Raises PolicyError for an unknown kind, or options that do not fit."""
    return find(kind).load(options)


def spec(kind: str, options: Mapping[str, Any]) -> PolicySpec:
    """Return a policy's spec. Raises PolicyError as `load` does."""
    policy_kind = find(kind)
    return policy_kind.spec(options) if policy_kind.spec is not None else policy_kind.load(options).spec


def wishes(kind: str, options: Mapping[str, Any]) -> Wishes:
    """Return what a policy asks of a suite. Raises PolicyError as `load` does."""
    asked = find(kind).wishes
    return Wishes() if asked is None else asked(options)


def digest(kind: str, options: Mapping[str, Any]) -> str:
    """Return the hash of a policy's content. Raises PolicyError as `load` does."""
    return find(kind).digest(options)
