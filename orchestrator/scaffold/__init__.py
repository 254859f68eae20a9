"""Writes the package of a new adapter: one that works at once, on a toy, to be made one's own piece by piece."""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection
from pathlib import Path

TEMPLATE = Path(__file__).parent / "template"
TOY = "toysim"
NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
LONGEST = 40


class ScaffoldError(Exception):
    """The package cannot be written; the message says what and why, in a line."""


def write_package(name: str, folder: Path, taken: Collection[str]) -> list[Path]:
    """Write a package whose adapter declares the simulator `name`.

    Args:
        name: Of the simulator, such as `mysim`.
        folder: To make.
        taken: Names of simulators that exist.

    Returns:
        The files, below `folder`, sorted.

    Raises:
        ScaffoldError: The name cannot be used, or the folder cannot be made or written.
    """
    if not NAME.fullmatch(name) or len(name) > LONGEST:
        raise ScaffoldError(
            f"expected a name of up to {LONGEST} small letters, digits and single dashes, such as my-sim; got '{name}'"
        )
    if name in taken:
        raise ScaffoldError(f"there is a simulator '{name}' already; choose another name")
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise ScaffoldError(f"{folder} exists; give another folder with --out") from None
    except OSError as error:
        raise ScaffoldError(f"{folder} cannot be made: {error.strerror}") from None
    sources = [path for path in TEMPLATE.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    try:
        return sorted(_written(source, name, folder) for source in sources)
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise ScaffoldError(f"{folder} cannot be written: {error.strerror}") from None


def _written(source: Path, name: str, folder: Path) -> Path:
    """A file of the template, under the simulator's name in path and text."""
    target = folder / renamed(source.relative_to(TEMPLATE).as_posix(), name)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(renamed(source.read_text(encoding="utf-8"), name), encoding="utf-8")
    return target


def renamed(text: str, name: str) -> str:
    """The template's text with the toy's name replaced: within names of modules, of classes, and as it is."""
    forms = {
        f"_{TOY}": "_" + name.replace("-", "_"),
        TOY.capitalize(): "".join(part.capitalize() for part in name.split("-")),
        TOY: name,
    }
    return re.sub("|".join(forms), lambda found: forms[found.group()], text)
