"""How another environment imports the very source that runs here."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from orchestrator.environments.environment import root
from suites.vocabulary import content_hash

ROOMS = ("adapters", "orchestrator", "policies", "results", "suites")
DISTRIBUTION = "robogauntlet"


def import_path() -> str:
    """PYTHONPATH for a process in another environment: this source first, then what is on this process's own.

    Raises:
        OSError: The folder that shows the source cannot be written.
    """
    inherited = os.environ.get("PYTHONPATH")
    return os.pathsep.join([str(_door(root())), *([inherited] if inherited else [])])


def place_of(module: str) -> str:
    """Where a module of ours lies, links resolved."""
    found = find_spec(module)
    assert found is not None
    assert found.origin is not None
    return os.path.realpath(found.origin)


@cache
def _door(folder: Path) -> Path:
    """A folder with links to the packages that run here, and what their distribution declares, and nothing else.

    The source's own folder would not do: it may be a site-packages, which holds everything else besides, and it need
    not hold the declarations.
    """
    packages = {room: str(Path(place_of(room)).parent) for room in ROOMS}
    distribution = metadata.distribution(DISTRIBUTION)
    about = distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or ""
    entry_points = distribution.read_text("entry_points.txt") or ""
    door = folder / f".source-{content_hash([packages, about, entry_points])}"
    if door.is_dir():
        return door
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".source-partial-") as name:
        partial = Path(name) / "door"
        information = partial / f"{DISTRIBUTION}-{distribution.version}.dist-info"
        information.mkdir(parents=True)
        (information / "METADATA").write_text(about, encoding="utf-8")
        (information / "entry_points.txt").write_text(entry_points, encoding="utf-8")
        for room, place in packages.items():
            (partial / room).symlink_to(place)
        try:
            partial.rename(door)
        except OSError:  # another process was quicker
            if not door.is_dir():
                raise
    return door
