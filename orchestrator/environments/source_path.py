"""Makes this process's RoboGauntlet source importable in other environments."""

from __future__ import annotations

import os
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from robogauntlet.orchestrator.environments.environment import root
from robogauntlet.suites.episode import content_hash
from robogauntlet.support.files import new_folder

PACKAGE = "robogauntlet"


def import_path() -> str:
    """PYTHONPATH for a process in another environment: this source, then the PYTHONPATH of this process.

    Raises:
        OSError: The folder with links to the source cannot be written.
    """
    inherited = os.environ.get("PYTHONPATH")
    return os.pathsep.join([str(_source_links(root())), *([inherited] if inherited else [])])


def source_file(module: str) -> str:
    """The file of a module, with links resolved."""
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return os.path.realpath(spec.origin)


@cache
def _source_links(folder: Path) -> Path:
    """A folder that contains only a link to this package and its distribution's metadata.

    The folder of the source itself may be a site-packages folder with other packages, or may lack the metadata.
    """
    package = str(Path(source_file(PACKAGE)).parent)
    distribution = metadata.distribution(PACKAGE)
    about = distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or ""
    entry_points = distribution.read_text("entry_points.txt") or ""
    links = folder / f".source-{content_hash([package, about, entry_points])}"
    if links.is_dir():
        return links
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with new_folder(links) as partial:
            information = partial / f"{PACKAGE}-{distribution.version}.dist-info"
            information.mkdir()
            (information / "METADATA").write_text(about, encoding="utf-8")
            (information / "entry_points.txt").write_text(entry_points, encoding="utf-8")
            (partial / PACKAGE).symlink_to(package)
    except OSError:  # another process may have created it
        if not links.is_dir():
            raise
    return links
