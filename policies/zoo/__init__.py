"""The zoo: checkpoints that are shipped, beside this file, and how a suite or a command refers to them."""

from __future__ import annotations

from pathlib import Path

from policies.contract import PolicyError
from suites.plugins import nearest

ZOO = Path(__file__).parent
SCHEME = "zoo:"


class NotShipped(PolicyError):
    """A reference to the zoo that names nothing in it."""


def shipped(reference: str) -> Path:
    """The folder that a reference stands for.

    `zoo:NAME`, or `zoo:NAME/PART`, is that folder of the zoo, wherever the program is run. Anything
    else is a path as it stands (relative to the working directory), or a hub id, left to whoever opens it.

    Raises:
        NotShipped: The zoo has no such folder.
    """
    if not reference.startswith(SCHEME):
        return Path(reference)
    name = reference.removeprefix(SCHEME)
    folder = (ZOO / name).resolve()
    if not name or not folder.is_relative_to(ZOO.resolve()) or folder == ZOO.resolve() or not folder.is_dir():
        there = [path.name for path in ZOO.glob("*") if (path / "card.json").is_file() or any(path.glob("*/card.json"))]
        raise NotShipped(
            f"expected the name of a shipped checkpoint after '{SCHEME}', got '{name}'{nearest(name, there)}"
        )
    return folder
