"""Writes folders of source files from templates that work before anything is changed in them."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from robogauntlet.support.errors import BadInput

LONGEST = 40
SEPARATORS = {"-": "dashes", "_": "underscores"}


@dataclass(frozen=True)
class Template:
    """A folder of files that are written under the user's name."""

    folder: Path
    placeholder: str
    """Lower-case name in its files, in modules and classes too, that the user's name replaces."""
    separator: str
    """Between the words of a name: a dash, or an underscore where the name is that of a Python module."""

    def write(self, name: str, folder: Path) -> list[Path]:
        """Write the files into a new folder and return them, sorted.

        Raises:
            BadInput: The name is not valid, or the folder cannot be created or written.
        """
        sign, example = self.separator, f"my{self.separator}{self.placeholder.removeprefix('toy')}"
        if not re.fullmatch(f"[a-z][a-z0-9]*({sign}[a-z0-9]+)*", name) or len(name) > LONGEST:
            raise BadInput(
                f"expected a name of up to {LONGEST} small letters, digits and single {SEPARATORS[sign]}, such as "
                f"{example}; got '{name}'"
            )
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise BadInput(f"{folder} exists; give another folder with --out") from None
        except OSError as error:
            raise BadInput(f"{folder} cannot be created: {error.strerror}") from None
        sources = [path for path in self.folder.rglob("*") if path.is_file() and path.suffix != ".pyc"]
        targets = {
            folder / self.renamed(source.relative_to(self.folder).as_posix(), name): source for source in sources
        }
        try:
            for target, source in targets.items():
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(self.renamed(source.read_text(encoding="utf-8"), name), encoding="utf-8")
        except OSError as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise BadInput(f"{folder} cannot be written: {error.strerror}") from None
        return sorted(targets)

    def renamed(self, text: str, name: str) -> str:
        """Replace the placeholder in a text: in names of modules and classes, and on its own."""
        forms = {
            f"_{self.placeholder}": "_" + name.replace("-", "_"),
            self.placeholder.capitalize(): "".join(part.capitalize() for part in name.split(self.separator)),
            self.placeholder: name,
        }
        return re.sub("|".join(forms), lambda found: forms[found.group()], text)


ADAPTER = Template(Path(__file__).parent / "template" / "adapter", "toysim", "-")
"""The package of a new adapter, which works on a toy until the author replaces it."""
BENCHMARK = Template(Path(__file__).parent / "template" / "benchmark", "toybenchmark", "-")
"""The package of a benchmark of vla-evaluation-harness, without its module."""
POLICY = Template(Path(__file__).parent / "template" / "policy", "toypolicy", "_")
"""The module of a new policy, its tests and a suite."""
