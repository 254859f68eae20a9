"""`gauntlet adapters new`: a package for a simulator that RoboGauntlet does not know."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from adapters import catalog
from orchestrator.cli.shared import BadInput, out
from orchestrator.scaffold import ScaffoldError, write_package


def new(
    name: Annotated[str, typer.Argument(help="Of the simulator, such as mysim.")],
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Folder to make; by default robogauntlet-NAME here.")
    ] = None,
) -> None:
    """Write the package of a new adapter. It works at once, on a toy, which your simulator replaces piece by piece."""
    folder = out_folder or Path(f"robogauntlet-{name}")
    try:
        files = write_package(name, folder, catalog.simulators())
    except ScaffoldError as error:
        raise BadInput(str(error)) from None
    for path in files:
        out.print(str(path), markup=False, soft_wrap=True)
    out.print(f"\ncd {folder}", markup=False, soft_wrap=True)
    out.print("pip install --no-deps --no-build-isolation -e .", markup=False)
    out.print(f"gauntlet adapters check {name}", markup=False)
