"""What playing the episodes of an imported run would use of its author's choice. Reads the suite; touches nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from robogauntlet.policies.zoo import SCHEME
from robogauntlet.results.run_document import RunDocument
from robogauntlet.suites.schema import PolicyEntry, Suite
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import visible

USES: Mapping[str, Mapping[str, str]] = {
    **{kind: {} for kind in ("oracle", "random", "zero", "untrained")},
    "replay": {"demonstrations": "reads"},
    "python": {"callable": "imports and calls", "options": "gives it", "folder": "from", "files": "reads"},
    "openpi": {"address": "contacts", "token_variable": "sends the content of the variable"},
    "lerobot": {"checkpoint": "reads", "python": "starts"},
    "mergevla": {"checkpoint": "reads"},
    "mergevla-experts": {"folder": "reads"},
    "mergevla-merged": {"checkpoint": "reads", "experts": "reads"},
}
"""Kind of policy to the options that name something outside of the suite, and what is done with it."""
NETWORKS = ("mergevla", "mergevla-experts", "mergevla-merged")
"""Kinds of policies that may name checkpoints of the zoo."""
LONGEST = 500
"""Largest length of a value in a message (characters)."""


class NotTrusted(BadInput):
    """An imported run whose episodes cannot be played without trust in its author."""


def chosen_parts(suite: Suite) -> list[str]:
    """Return what the suite chooses to import, contact, read or start, a line each; empty if it needs no trust."""
    parts = [part for policy in suite.policies for part in _policy_parts(policy)]
    for user, environment in suite.environments.items():
        if environment.interpreter is not None:
            parts.append(f"{_shown(user)} starts {_shown(environment.interpreter)}")
    return parts


def require_trust(document: RunDocument, folder: Path, *, trust: bool) -> None:
    """Refuse to play episodes of an imported run that uses something of its author's choice, unless `trust`.

    Raises:
        NotTrusted: The message lists everything that would be imported, contacted, read or started.
    """
    if trust or document.origin == "local":
        return
    if parts := chosen_parts(document.suite):
        raise NotTrusted(
            f"{folder}: an imported run, whose author chose what playing it uses: {'; '.join(parts)}; "
            "give --trust if you trust all of it"
        )


def _policy_parts(policy: PolicyEntry) -> list[str]:
    """What a policy uses, in one line; none for the zoo's checkpoints, which are installed."""
    verbs = USES.get(policy.kind, dict.fromkeys(policy.options, f"gives {_shown(policy.kind)}"))
    used = [
        f"{verb} {_shown(policy.options[option])}"
        for option, verb in verbs.items()
        if option in policy.options and not (policy.kind in NETWORKS and _of_the_zoo(policy.options[option]))
    ]
    return [f"policy {_shown(policy.name)} {', '.join(used)}"] if used else []


def _of_the_zoo(value: object) -> bool:
    return isinstance(value, str) and value.startswith(SCHEME)


def _shown(value: object) -> str:
    """A value on one line, without control characters, shortened."""
    text = value if isinstance(value, str) else json.dumps(value, default=str)
    plain = visible(text)
    return plain if len(plain) <= LONGEST else f"{plain[: LONGEST - 4]} ..."
