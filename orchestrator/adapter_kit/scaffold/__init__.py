"""Writes the package of a new adapter, which works on a toy until the author replaces it."""

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
    """The package cannot be written; the message says why in one line."""


def write_package(name: str, folder: Path, taken: Collection[str]) -> list[Path]:
    """Write a package whose adapter declares the simulator `name`, and return its files below `folder`, sorted.

    Raises:
        ScaffoldError: The name is not valid, or the folder cannot be created or written.
    """
    if not NAME.fullmatch(name) or len(name) > LONGEST:
        raise ScaffoldError(
            f"expected a name of up to {LONGEST} small letters, digits and single dashes, such as my-sim; got '{name}'"
        )
    if name in taken:
        raise ScaffoldError(f"the simulator '{name}' exists already; choose another name")
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise ScaffoldError(f"{folder} exists; give another folder with --out") from None
    except OSError as error:
        raise ScaffoldError(f"{folder} cannot be created: {error.strerror}") from None
    sources = [path for path in TEMPLATE.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    targets = {folder / renamed(source.relative_to(TEMPLATE).as_posix(), name): source for source in sources}
    try:
        for target, source in targets.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(renamed(source.read_text(encoding="utf-8"), name), encoding="utf-8")
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise ScaffoldError(f"{folder} cannot be written: {error.strerror}") from None
    return sorted(targets)


def renamed(text: str, name: str) -> str:
    """Replace the toy's name in a text of the template: in names of modules and classes, and on its own."""
    forms = {
        f"_{TOY}": "_" + name.replace("-", "_"),
        TOY.capitalize(): "".join(part.capitalize() for part in name.split("-")),
        TOY: name,
    }
    return re.sub("|".join(forms), lambda found: forms[found.group()], text)
