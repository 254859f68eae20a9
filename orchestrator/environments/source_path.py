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
POLICIES = "robogauntlet.policies"
"""The group of entry points by which distributions declare kinds of policies."""


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
    """A folder with links to this package and those that declare kinds of policies, and their distributions' metadata.

    The folders of the sources themselves may be site-packages folders with other packages, or may lack the metadata.
    """
    packages = {entry.module.partition(".")[0]: entry.dist for entry in metadata.entry_points(group=POLICIES)}
    packages[PACKAGE] = metadata.distribution(PACKAGE)
    sources = [
        (
            str(place.parent if (place := Path(source_file(package))).name == "__init__.py" else place),
            f"{distribution.name.replace('-', '_')}-{distribution.version}.dist-info",
            distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or "",
            distribution.read_text("entry_points.txt") or "",
        )
        for package, distribution in sorted(packages.items())
        if distribution is not None and (spec := find_spec(package)) is not None and spec.origin is not None
    ]
    links = folder / f".source-{content_hash(sources)}"
    if links.is_dir():
        return links
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with new_folder(links) as partial:
            for source, information, about, entry_points in sources:
                (partial / information).mkdir(exist_ok=True)
                (partial / information / "METADATA").write_text(about, encoding="utf-8")
                (partial / information / "entry_points.txt").write_text(entry_points, encoding="utf-8")
                (partial / Path(source).name).symlink_to(source)
    except OSError:  # another process may have created it
        if not links.is_dir():
            raise
    return links
