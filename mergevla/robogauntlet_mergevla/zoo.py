"""The zoo: checkpoints that are published with RoboGauntlet, and references to them."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from robogauntlet.policies.contract import PolicyError
from robogauntlet.suites.plugins import did_you_mean

SCHEME = "zoo:"
PACKAGE = "robogauntlet_zoo"


class NotShipped(PolicyError):
    """A reference to an unknown checkpoint of the zoo, or a zoo that is not installed."""


@cache
def zoo_folder() -> Path:
    """Return the folder of the checkpoints: a clone's own, else that of the distribution `robogauntlet-zoo`."""
    in_clone = Path(__file__).resolve().parents[2] / "zoo" / PACKAGE
    if in_clone.is_dir():
        return in_clone
    spec = find_spec(PACKAGE)
    if spec is None or not spec.submodule_search_locations:
        raise NotShipped(f"'{SCHEME}' checkpoints are not installed; in a clone of the repository: pip install ./zoo")
    return Path(spec.submodule_search_locations[0]).resolve()


def shipped(reference: str) -> Path:
    """Return the folder of a reference.

    `zoo:NAME` and `zoo:NAME/PART` are folders of the zoo, independent of the working directory; NotShipped if there is
    none. Any other reference is a path or a hub id, and is returned unchanged.
    """
    if not reference.startswith(SCHEME):
        return Path(reference)
    zoo = zoo_folder().resolve()
    name = reference.removeprefix(SCHEME)
    folder = (zoo / name).resolve()
    if not name or not folder.is_relative_to(zoo) or folder == zoo or not folder.is_dir():
        known = [path.name for path in zoo.glob("*") if (path / "card.json").is_file() or any(path.glob("*/card.json"))]
        raise NotShipped(
            f"expected the name of a shipped checkpoint after '{SCHEME}', got '{name}'{did_you_mean(name, known)}"
        )
    return folder
