"""Policies that are named by one text, on the command line and in Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robogauntlet.policies import catalog, zoo
from robogauntlet.policies.mergevla.checkpoints.merged_metadata import KIND as MERGED
from robogauntlet.policies.mergevla.checkpoints.metadata import METADATA_FILE, read_metadata_file
from robogauntlet.policies.mergevla.options import EXPERTS_NAME, MERGED_NAME
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.schema import PolicyEntry, policy_entry, valid_name
from robogauntlet.support.errors import BadInput

FORMS = "openpi://HOST:PORT, python:MODULE:NAME, lerobot:FOLDER, zoo:NAME, the folder of a checkpoint or a kind of policy"


def read_reference(text: str) -> PolicyEntry:
    """Return the policy that a text names: one of `FORMS`. Loads no weights.

    Raises:
        BadInput: There is no such policy.
        PolicyError: The zoo has no such checkpoint.
    """
    entry = policy_entry(text)
    if entry["kind"] in catalog.kinds():
        return PolicyEntry.model_validate(entry)
    kind, options = _checkpoint(text)
    return PolicyEntry(name=valid_name(text) or kind, kind=kind, options=dict(options))


def _checkpoint(reference: str) -> tuple[str, Mapping[str, Any]]:
    folder = zoo.shipped(reference)
    if (folder / METADATA_FILE).is_file():
        merged = read_metadata_file(folder).get("kind") == MERGED
        return (MERGED_NAME if merged else "mergevla"), {"checkpoint": reference}
    if any(folder.glob(f"*/{METADATA_FILE}")):
        return EXPERTS_NAME, {"folder": reference}
    raise BadInput(f"expected {FORMS}; got '{reference}'{did_you_mean(reference, catalog.kinds())}")
