"""Reports a file that an installed simulator lacks, such as a mesh of an arm, as one line that says what to do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from robogauntlet.adapters.contract import SimulatorUnavailable


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
