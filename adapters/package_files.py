"""Finds the files of an installed package, and reports one that is missing as a line that says what to do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.util import find_spec
from pathlib import Path

from robogauntlet.adapters.contract import SimulatorUnavailable

_further: ContextVar[tuple[Path, ...]] = ContextVar("further", default=())


@contextmanager
def looking_in(folders: Sequence[Path]) -> Iterator[None]:
    """Look into these folders `site-packages` too, those of a simulator's own environment, while the block runs."""
    token = _further.set(tuple(folders))
    try:
        yield
    finally:
        _further.reset(token)


def folder_of(module: str) -> Path | None:
    """Return the folder of an installed module, which is not imported, or None."""
    spec = find_spec(module)
    places = [] if spec is None else [Path(place) for place in spec.submodule_search_locations or ()]
    return next((place for place in (*places, *(folder / module for folder in _further.get())) if place.is_dir()), None)


@contextmanager
def files_of(package: str) -> Iterator[None]:
    """Open files of a package's installation.

    Args:
        package: Its name on the package index.

    Raises:
        SimulatorUnavailable: One is missing.
    """
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:  # SAPIEN and MuJoCo raise the last two for files.
        if "No such file" not in str(error):
            raise
        raise SimulatorUnavailable(
            f"a file of {package} is missing ({error}); "
            f"install it again: pip install --force-reinstall --no-deps {package}"
        ) from error
