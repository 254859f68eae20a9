"""`robogauntlet new adapter`: create the package of a new adapter."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.cli.common import print_line
from robogauntlet.orchestrator.kit.scaffold import ADAPTER
from robogauntlet.support.errors import BadInput


def new(
    name: Annotated[str, typer.Argument(help="Name of the simulator, such as mysim.")],
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Folder to create; by default robogauntlet-NAME.")
    ] = None,
) -> None:
    """Create the package of a new adapter.

    The package works from the start, with a toy simulation that you replace piece by piece.
    """
    folder = out_folder or Path(f"robogauntlet-{name}")
    if name in catalog.simulators():
        raise BadInput(f"the simulator '{name}' exists already; choose another name")
    for path in ADAPTER.write(name, folder):
        print_line(str(path))
    print_line(f"\ncd {folder}")
    print_line("pip install --no-deps -e .")
    print_line(f"robogauntlet check adapter {name}")
