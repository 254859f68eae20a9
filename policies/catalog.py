"""The catalog of policy kinds, from entry points of the group `robogauntlet.policies`. Loads no weights."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from robogauntlet.policies.contract import Policy, PolicyError, PolicyKind, PolicySpec, Wishes
from robogauntlet.suites.plugins import BrokenPlugin, Plugins, did_you_mean

GROUP = "robogauntlet.policies"
SEPARATE = ("mergevla", "mergevla-experts", "mergevla-merged")
"""Kinds that shipped suites name and that a distribution of its own declares."""
INSTALL = "in a clone of the repository: pip install ./mergevla ./zoo"
"""What installs it, and its checkpoints."""


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
        raise PolicyError(unknown(kind))
    return known[kind]


def unknown(kind: str) -> str:
    """Return the message for a kind that is not installed: what installs it, or what it may have meant."""
    if kind in SEPARATE:
        return f"policy '{kind}' is not installed; {INSTALL}"
    return f"unknown policy '{kind}'{did_you_mean(kind, kinds())}"


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


def digest_in(kind: str, options: Mapping[str, Any], task: str) -> str:
    """Return the hash of what acts in a task (`simulator/task`). Raises PolicyError as `load` does."""
    part = find(kind).digest_in
    return digest(kind, options) if part is None else part(options, task)
