"""LIBERO's assets (meshes, textures, scenes): where they are, and whose they are. Imports nothing of LIBERO.

The distribution does not carry them. `python -m adapters.libero.assets` says what would be used; with `--unpack FILE`
it unpacks an archive that holds a folder `assets`, and with `--download` it has LIBERO fetch its own from the Hugging
Face Hub. Nothing is ever fetched unasked.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import tarfile
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import yaml

from adapters.contract import SimulatorUnavailable

VARIABLE = "ROBOGAUNTLET_LIBERO_ASSETS"
"""Environment variable that names the folder, before any other place."""
PARTS = (
    "articulated_objects",
    "scenes",
    "stable_hope_objects",
    "stable_scanned_objects",
    "textures",
    "turbosquid_objects",
)
STAND_INS = "STAND_INS.txt"
"""A file in the folder that lists what is not upstream's own."""


@dataclass(frozen=True)
class Assets:
    """A folder of assets."""

    folder: Path
    stand_ins: bool
    """Whether the folder says that some of its files only stand in for upstream's."""

    def fingerprint(self) -> str:
        """Hash of the names and sizes of all files, 8 hexadecimal digits: different assets, for all that is likely."""
        files = sorted(path for path in self.folder.rglob("*") if path.is_file())
        listed = "".join(f"{path.relative_to(self.folder).as_posix()} {path.stat().st_size}\n" for path in files)
        return hashlib.sha256(listed.encode()).hexdigest()[:8]

    def __str__(self) -> str:
        return f"LIBERO assets {self.fingerprint()} {'with' if self.stand_ins else 'without'} stand-ins"


def package_folder() -> Path | None:
    """Where the package `libero.libero` lies, found without importing it (which asks questions), or None."""
    spec = find_spec("libero")
    if spec is None or not spec.submodule_search_locations:
        return None
    return Path(next(iter(spec.submodule_search_locations))) / "libero"


def own_folder() -> Path:
    """Where `--unpack` and LIBERO's own download put assets."""
    return Path.home() / ".cache" / "libero" / "assets"


def configuration() -> Path:
    """LIBERO's own configuration file."""
    return Path(os.environ.get("LIBERO_CONFIG_PATH", Path.home() / ".libero")) / "config.yaml"


def places() -> Iterator[tuple[str, Path]]:
    """Where assets are looked for, the first first, and what says so."""
    if named := os.environ.get(VARIABLE):
        yield VARIABLE, Path(named)
        return
    if configuration().is_file():
        said = yaml.safe_load(configuration().read_text(encoding="utf-8"))
        if isinstance(said, dict) and isinstance(said.get("assets"), str):
            yield str(configuration()), Path(said["assets"])
    package = package_folder()
    if package is not None:
        yield "the package's own folder", package / "assets"
    yield "LIBERO's cache", own_folder()


def find_assets() -> Assets:
    """The assets to use.

    Raises:
        SimulatorUnavailable: There are none; with where was looked, and what to do.
    """
    looked = dict(places())
    for folder in looked.values():
        if all((folder / part).is_dir() for part in PARTS):
            return Assets(folder.resolve(), (folder / STAND_INS).is_file())
    where = ", ".join(f"{folder} ({said})" for said, folder in looked.items())
    raise SimulatorUnavailable(
        f"LIBERO's assets are missing: expected folders {PARTS[0]}, {PARTS[1]}, ... in {where}; name theirs in "
        f"{VARIABLE}, or get them with: python -m adapters.libero.assets --download, or --unpack ARCHIVE"
    )


def unpack(archive: Path, folder: Path) -> Assets:
    """Unpack an archive's folder `assets` as `folder`, unless it is there already.

    It is there as a whole or not at all.

    Raises:
        SimulatorUnavailable: The archive holds no such folder, or something else than files and folders in it.
    """
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with (
            tarfile.open(archive) as packed,
            tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-partial-") as partial,
        ):
            inside = [member for member in packed.getmembers() if member.name.partition("/")[0] == "assets"]
            if not inside:
                raise SimulatorUnavailable(f"{archive}: expected a folder 'assets' in this archive, found none")
            for member in inside:  # Python before 3.11.4 has no filters that would see to it
                if not (member.isreg() or member.isdir()) or ".." in Path(member.name).parts:
                    raise SimulatorUnavailable(f"{archive}: expected files and folders, found {member.name}")
                member.mode = 0o755 if member.isdir() else 0o644
            packed.extractall(partial, inside)
            (Path(partial) / "assets").rename(folder)
    return Assets(folder.resolve(), (folder / STAND_INS).is_file())


def _main() -> None:
    parser = argparse.ArgumentParser(prog="python -m adapters.libero.assets", description=__doc__)
    doing = parser.add_mutually_exclusive_group()
    doing.add_argument("--unpack", type=Path, metavar="ARCHIVE", help=f"unpack it to {own_folder()}")
    doing.add_argument("--download", action="store_true", help="have LIBERO download its own, to the same place")
    asked = parser.parse_args()
    try:
        if asked.unpack is not None:
            unpack(asked.unpack, own_folder())
        if asked.download:
            from adapters.libero.package import import_libero

            import_libero().download_assets()
        assets = find_assets()
    except (SimulatorUnavailable, OSError, tarfile.TarError, ImportError) as error:
        raise SystemExit(str(error)) from None
    print(f"{assets}, in {assets.folder}")


if __name__ == "__main__":
    _main()
