"""Imports LIBERO, and keeps what is wrong or dangerous in it away from results.

- It asks questions on the terminal when it has no configuration file: it gets one for as long as it is imported.
- It needs robosuite 1.4, and MuJoCo below 3.4: later ones let the stored states' objects jump (they lie up to 3 cm
  inside the table), so that they come to rest elsewhere.
- It downloads its assets when they are missing: it is told where they are, or not imported at all.
- Its stored states are pickles: only NumPy's arrays are unpickled.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from adapters.contract import AdapterError, FloatArray, SimulatorUnavailable
from adapters.libero.assets import Assets, configuration, find_assets, package_folder
from adapters.mujoco_parts.simulation import import_with_mujoco

ROBOSUITE = "1.4."
"""How the version of robosuite must begin."""
MUJOCO_BELOW = (3, 4)


@dataclass(frozen=True)
class Libero:
    """The package, imported."""

    folder: Path
    """Where `libero.libero` lies."""
    mujoco: Any
    environment: Any
    """LIBERO's `ControlEnv`, which `OffScreenRenderEnv` draws for."""
    task_map: Mapping[str, Sequence[str]]
    """LIBERO's name of a suite to its tasks' names, in order."""
    assets: Assets | None = None
    """None if no task is to be opened."""

    def description(self, suite: str, name: str) -> Path:
        """The BDDL file of a task."""
        return self.folder / "bddl_files" / suite / f"{name}.bddl"

    def parse(self, suite: str, name: str) -> Mapping[str, Any]:
        """What is in a task's BDDL file."""
        parsing = importlib.import_module("libero.libero.envs.bddl_utils")
        parsed: Mapping[str, Any] = parsing.robosuite_parse_problem(str(self.description(suite, name)))
        return parsed

    def stored_states(self, suite: str, name: str) -> FloatArray:
        """A task's stored initial states, see `read_states`."""
        return read_states(self.folder / "init_files" / suite / f"{name}.pruned_init")

    def download_assets(self) -> None:
        """Have LIBERO download its assets to where it does by default."""
        with silenced():
            importlib.import_module("libero.libero.utils.download_utils").download_assets_from_huggingface()


def import_libero(assets: Assets | None = None) -> Libero:
    """Import LIBERO and what it stands on.

    Args:
        assets: Those to use, without which no task can be opened.

    Raises:
        SimulatorUnavailable: LIBERO is not installed, or stands on versions that would change its results.
    """
    folder = package_folder()
    if folder is None:
        raise SimulatorUnavailable("no module named 'libero': gauntlet env create libero")
    check_versions(version("robosuite"), version("mujoco"))
    with configured(folder), silenced():
        mujoco, libero, wrapper = import_with_mujoco("libero", "libero.libero", "libero.libero.envs.env_wrapper")
        task_map = importlib.import_module("libero.libero.benchmark.libero_suite_task_map").libero_task_map
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
    """Refuse versions under which LIBERO is another benchmark, or none.

    Raises:
        SimulatorUnavailable: With what is needed and what is there.
    """
    mend = "LIBERO has an environment of its own, make it with: gauntlet env create libero"
    if not robosuite.startswith(ROBOSUITE):
        raise SimulatorUnavailable(f"LIBERO needs robosuite 1.4.0, found {robosuite}; {mend}")
    if tuple(int(part) for part in mujoco.split(".")[:2]) >= MUJOCO_BELOW:
        raise SimulatorUnavailable(
            f"LIBERO needs mujoco below 3.4, found {mujoco}: later ones let its stored states jump; {mend}"
        )


def read_states(path: Path) -> FloatArray:
    """The stored initial states of a task.

    Args:
        path: A file as `torch.save` writes it, of one array.

    Returns:
        Shape (50, 1 + nq + nv): time, joint positions and velocities of MuJoCo's model.

    Raises:
        AdapterError: The file holds anything but an array of numbers.
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
    """Unpickles arrays of numbers and refuses everything else, so that a file cannot run anything."""

    allowed = frozenset(
        {
            ("numpy.core.multiarray", "_reconstruct"),
            ("numpy._core.multiarray", "_reconstruct"),
            ("numpy", "ndarray"),
            ("numpy", "dtype"),
            ("_codecs", "encode"),
        }
    )

    def find_class(self, module: str, name: str) -> Any:
        """The few that an array is made of."""
        if (module, name) not in self.allowed:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        return super().find_class(module, name)


@contextlib.contextmanager
def configured(folder: Path) -> Iterator[None]:
    """Give LIBERO a configuration file while it is imported, unless it has one: it would ask for it."""
    if configuration().is_file():
        yield
        return
    before = os.environ.get("LIBERO_CONFIG_PATH")
    with tempfile.TemporaryDirectory() as place:
        paths = {"benchmark_root": ".", "bddl_files": "bddl_files", "init_states": "init_files", "assets": "assets"}
        said = {key: str(folder / value) for key, value in paths.items()} | {"datasets": place}
        (Path(place) / "config.yaml").write_text(yaml.safe_dump(said), encoding="utf-8")
        os.environ["LIBERO_CONFIG_PATH"] = place
        try:
            yield
        finally:
            del os.environ["LIBERO_CONFIG_PATH"]
            if before is not None:
                os.environ["LIBERO_CONFIG_PATH"] = before


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Keep what LIBERO prints off the terminal."""
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        yield
