"""Policies that are named by one text, on the command line and in Python."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from robogauntlet.policies import catalog
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.schema import PolicyEntry, policy_entry, valid_name
from robogauntlet.suites.selection import SETTINGS, option_of
from robogauntlet.suites.yaml_file import YamlError, parse_yaml
from robogauntlet.support.errors import BadInput

SHOWN = 80
"""Characters of an option's value in a message."""
FORMS = (
    "openpi://HOST:PORT or another server's address (robogauntlet list policies), python:MODULE:NAME, lerobot:FOLDER, "
    "zoo:NAME, the folder of a checkpoint or a kind of policy"
)


def read_reference(text: str) -> PolicyEntry:
    """Return the policy that a text names, one of `FORMS`. Loads no weights.

    Raises:
        BadInput: There is no such policy.
        PolicyError: It can only be meant for one kind, and is wrong.
    """
    entry = policy_entry(text)
    if entry["kind"] in catalog.kinds():
        return PolicyEntry.model_validate(entry)
    for kind in catalog.kinds().values():
        if kind.named is not None and (own := kind.named(text)) is not None:
            return PolicyEntry(name=valid_name(text) or kind.name, kind=kind.name, options=dict(own))
    raise BadInput(f"expected {FORMS}; got '{text}'{_meant(text)}")


def with_options(entries: Sequence[PolicyEntry], options: Mapping[str, Any]) -> list[PolicyEntry]:
    """Give each policy those of the options that its kind has. Raises BadInput for an option that no policy has."""
    known = {entry.kind: catalog.find(entry.kind).options for entry in entries}
    for name in options:
        if not any(name in own for own in known.values()):
            every = dict.fromkeys(option for own in known.values() for option in own)
            hint = f"; it is a key of suites: {option_of(name)}" if name in SETTINGS else did_you_mean(name, every)
            kinds = "', '".join(known)
            raise BadInput(f"policy '{kinds}' has no option '{name}'{hint}")
    return [
        entry.model_copy(
            update={
                "options": {**entry.options, **{name: options[name] for name in options if name in known[entry.kind]}}
            }
        )
        for entry in entries
    ]


def read_options(texts: Sequence[str]) -> dict[str, Any]:
    """Return options that are given as `NAME=VALUE`, with values in YAML. Raises BadInput if one is not."""
    options = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not sign or not name:
            raise BadInput(f"--option: expected NAME=VALUE, got '{text}'")
        try:
            options[name] = parse_yaml(value).data
        except YamlError as error:
            raise BadInput(f"--option {name}: {error}, got '{value[:SHOWN]}'") from None
    return options


def option_text(name: str, value: Any) -> str:
    """Return an option as `NAME=VALUE`, the inverse of `read_options`."""
    return f"{name}={json.dumps(value, default=str)}"


def _meant(reference: str) -> str:
    """The end of a message about a text that names no policy: what it may have meant."""
    scheme, separator, rest = reference.partition("://")
    folder = Path(reference)
    if reference.startswith("zoo:") or reference in catalog.SEPARATE:
        return f", which is not installed; {catalog.INSTALL}"
    if separator and scheme in ("http", "https"):
        return did_you_mean(reference, (), meant=[f"openpi://{rest}", f"openvla+{reference}"])
    if (folder / "config.json").is_file() or (reference.startswith("lerobot/") and not folder.exists()):
        return did_you_mean(reference, (), meant=[f"lerobot:{reference}"])
    if folder.is_dir():
        return ", a folder without a checkpoint: no kind of policy knows what is in it"
    near = get_close_matches(reference, catalog.kinds(), n=1, cutoff=0.7)
    return did_you_mean(reference, (), meant=near) if near else ""
