"""Hashes of a policy's source code."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

from robogauntlet.policies.contract import PolicyError
from robogauntlet.suites.episode import content_hash


def source_digest(*modules: ModuleType) -> str:
    """Return the hash of the source text of modules, the same on every machine (line ends are normalised)."""
    digest = hashlib.sha256()
    for module in modules:
        digest.update(module.__name__.encode() + b"\0")
        digest.update("\n".join(inspect.getsource(module).splitlines()).encode() + b"\0")
    return digest.hexdigest()[:16]


def scripted_digest(name: str, *modules: ModuleType) -> Callable[[Mapping[str, Any]], str]:
    """Return a `PolicyKind.digest` for policies that consist of source code and options."""
    return lambda options: digest_of(name, source_digest(*modules), options)


def digest_of(name: str, source: str, options: Mapping[str, Any]) -> str:
    """Return the digest of a policy of a kind by what stands for its source code, and its options."""
    try:
        return content_hash({"policy": name, "source": source, "options": dict(options)})
    except (TypeError, ValueError):
        raise PolicyError(f"policy '{name}': options must be plain numbers, text, lists and mappings") from None
