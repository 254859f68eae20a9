"""Imports LIBERO and LIBERO-PRO, and works around their problems.

- Its objects are found by the path that is known when it is imported, so the assets' folder is set before.
- It needs robosuite 1.4, and MuJoCo below 3.4: with later versions the objects of stored states, which are up to 3 cm
  inside the table, jump and come to rest in other places.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import AdapterError, FloatArray, SimulatorUnavailable
from robogauntlet.adapters.libero.assets import LIBERO, Assets, find_assets, package_folder
from robogauntlet.adapters.mujoco_parts.simulation import import_with_mujoco

ROBOSUITE = "1.4."
"""Beginning of robosuite's version."""
MUJOCO_BELOW = (3, 4)
PATHS: dict[str, str] = {}
"""What LIBERO's code is told instead of its configuration's paths."""


@dataclass(frozen=True)
class Libero:
    """The package, imported."""

    folder: Path
    """Folder of `libero.libero`."""
    mujoco: Any
    environment: Any
    """LIBERO's `ControlEnv`, without its renderer."""
    task_map: Mapping[str, Sequence[str]]
    """LIBERO's name of a suite to the names of its tasks, in order."""
    assets: Assets

    def description(self, suite: str, name: str) -> Path:
        """Return the path of a task's BDDL file."""
        return self.folder / "bddl_files" / suite / f"{name}.bddl"

    def parse(self, suite: str, name: str) -> Mapping[str, Any]:
        """Parse a task's BDDL file."""
        parsing = importlib.import_module("libero.libero.envs.bddl_utils")
        parsed: Mapping[str, Any] = parsing.robosuite_parse_problem(str(self.description(suite, name)))
        return parsed

    def stored_states(self, suite: str, name: str) -> FloatArray:
        """Return a task's stored initial states.

        Returns:
            Shape (50, 1 + nq + nv): time, joint positions and velocities of MuJoCo's model.

        Raises:
            AdapterError: The file is missing or damaged.
        """
        path = self.folder / "init_files" / suite / f"{name}.pruned_init.npz"
        try:
            with np.load(path, allow_pickle=False) as stored:
                return np.asarray(stored["states"], dtype=np.float64)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise AdapterError(f"{path}: expected LIBERO's stored states, an array of numbers; {error}") from None


def import_libero(simulator: str = LIBERO) -> Libero:
    """Import LIBERO with the assets of LIBERO or LIBERO-Plus.

    Raises:
        SimulatorUnavailable: LIBERO or its assets are missing, or a dependency has a version that would change its
            results.
    """
    folder = package_folder()
    if folder is None:
        raise SimulatorUnavailable("no module named 'libero': robogauntlet env create libero")
    check_versions(version("robosuite"), version("mujoco"))
    assets = find_assets(simulator)
    PATHS.update(bddl_files=f"{folder}/bddl_files", init_states=f"{folder}/init_files", assets=str(assets.folder))
    with silenced():
        mujoco, libero = import_with_mujoco("libero", "libero.libero")
        libero.get_libero_path = PATHS.__getitem__
        _, wrapper, tasks = import_with_mujoco(
            "libero", "libero.libero.envs.env_wrapper", "libero.libero.benchmark.libero_suite_task_map"
        )
    return Libero(folder, mujoco, wrapper.ControlEnv, tasks.libero_task_map, assets)


def check_versions(robosuite: str, mujoco: str) -> None:
    """Refuse versions that would change LIBERO's results.

    Raises:
        SimulatorUnavailable: A version is not the required one.
    """
    remedy = "create LIBERO's own environment: robogauntlet env create libero"
    if not robosuite.startswith(ROBOSUITE):
        raise SimulatorUnavailable(f"LIBERO needs robosuite 1.4.0, found {robosuite}; {remedy}")
    if tuple(int(part) for part in mujoco.split(".")[:2]) >= MUJOCO_BELOW:
        raise SimulatorUnavailable(
            f"LIBERO needs mujoco below 3.4, found {mujoco}: later versions change its stored states; {remedy}"
        )


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Hide LIBERO's output from the terminal."""
    with Path(os.devnull).open("w", encoding="utf-8") as null, contextlib.redirect_stdout(null):
        yield
