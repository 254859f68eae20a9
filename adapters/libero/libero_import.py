"""Imports LIBERO, and works around its problems.

- It asks questions on the terminal if it has no configuration file, so it gets one during the import.
- It needs robosuite 1.4, and MuJoCo below 3.4: with later versions the objects of stored states, which are up to 3 cm
  inside the table, jump and come to rest in other places.
- It downloads missing assets, so their folder is set before a task is opened.
- Its stored states are pickles, so only NumPy's arrays are unpickled.
- Its package of benchmarks imports torch, which nothing here needs, so the names of its tasks are read without it.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import runpy
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from robogauntlet.adapters.contract import AdapterError, FloatArray, SimulatorUnavailable
from robogauntlet.adapters.libero.assets import Assets, configuration, find_assets, package_folder
from robogauntlet.adapters.mujoco_parts.simulation import import_with_mujoco

ROBOSUITE = "1.4."
"""Beginning of robosuite's version."""
MUJOCO_BELOW = (3, 4)


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
    assets: Assets | None = None
    """None if no task will be opened."""

    def description(self, suite: str, name: str) -> Path:
        """Return the path of a task's BDDL file."""
        return self.folder / "bddl_files" / suite / f"{name}.bddl"

    def parse(self, suite: str, name: str) -> Mapping[str, Any]:
        """Parse a task's BDDL file."""
        parsing = importlib.import_module("libero.libero.envs.bddl_utils")
        parsed: Mapping[str, Any] = parsing.robosuite_parse_problem(str(self.description(suite, name)))
        return parsed

    def stored_states(self, suite: str, name: str) -> FloatArray:
        """Return a task's stored initial states, see `read_states`."""
        return read_states(self.folder / "init_files" / suite / f"{name}.pruned_init")


def import_libero(assets: Assets | None = None) -> Libero:
    """Import LIBERO. Without assets, no task can be opened.

    Raises:
        SimulatorUnavailable: LIBERO is not installed, or a dependency has a version that would change its results.
    """
    folder = package_folder()
    if folder is None:
        raise SimulatorUnavailable("no module named 'libero': robogauntlet env create libero")
    check_versions(version("robosuite"), version("mujoco"))
    with configured(folder), silenced():
        mujoco, libero, wrapper = import_with_mujoco("libero", "libero.libero", "libero.libero.envs.env_wrapper")
    task_map = runpy.run_path(str(folder / "benchmark" / "libero_suite_task_map.py"))["libero_task_map"]
    if assets is not None:
        libero._assets_path_cache = str(assets.folder)
    return Libero(folder, mujoco, wrapper.ControlEnv, task_map, assets)


def open_libero() -> Libero:
    """Import LIBERO with its assets.

    Raises:
        SimulatorUnavailable: See `import_libero` and `find_assets`.
    """
    return import_libero(find_assets())


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


def read_states(path: Path) -> FloatArray:
    """Read the stored initial states of a task from a file of `torch.save` with one array.

    Returns:
        Shape (50, 1 + nq + nv): time, joint positions and velocities of MuJoCo's model.

    Raises:
        AdapterError: The file contains anything except an array of numbers.
    """
    try:
        with zipfile.ZipFile(path) as packed:
            (name,) = [name for name in packed.namelist() if name.endswith("data.pkl")]
            with packed.open(name) as file:
                states = ArrayUnpickler(file).load()
    except (OSError, ValueError, zipfile.BadZipFile, pickle.UnpicklingError) as error:
        raise AdapterError(f"{path}: expected LIBERO's stored states, an array of numbers; {error}") from None
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


@contextlib.contextmanager
def configured(folder: Path) -> Iterator[None]:
    """Give LIBERO a configuration file during its import, unless it has one; otherwise it would ask questions."""
    if configuration().is_file():
        yield
        return
    before = os.environ.get("LIBERO_CONFIG_PATH")
    with tempfile.TemporaryDirectory() as folder_name:
        paths = {"benchmark_root": ".", "bddl_files": "bddl_files", "init_states": "init_files", "assets": "assets"}
        settings = {key: str(folder / value) for key, value in paths.items()} | {"datasets": folder_name}
        (Path(folder_name) / "config.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
        os.environ["LIBERO_CONFIG_PATH"] = folder_name
        try:
            yield
        finally:
            del os.environ["LIBERO_CONFIG_PATH"]
            if before is not None:
                os.environ["LIBERO_CONFIG_PATH"] = before


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Hide LIBERO's output from the terminal."""
    with Path(os.devnull).open("w", encoding="utf-8") as null, contextlib.redirect_stdout(null):
        yield
