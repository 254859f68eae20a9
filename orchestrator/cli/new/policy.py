"""`robogauntlet new policy`: create the files of a new policy."""

from __future__ import annotations

import keyword
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import print_line
from robogauntlet.orchestrator.kit.scaffold import POLICY
from robogauntlet.support.errors import BadInput


def new(
    name: Annotated[str, typer.Argument(help="Name of the policy and of its module, such as mypolicy.")],
    out_folder: Annotated[Path | None, typer.Option("--out", help="Folder to create; by default NAME.")] = None,
) -> None:
    """Create a folder with a policy, its tests and a suite.

    The policy is a Python class that works from the start; you replace what it computes.
    """
    folder = out_folder or Path(name)
    if name.isidentifier() and (keyword.iskeyword(name) or find_spec(name) is not None) and not folder.exists():
        raise BadInput(f"a Python module '{name}' exists already; choose another name")
    for path in POLICY.write(name, folder):
        print_line(str(path))
    title = POLICY.renamed(POLICY.placeholder.capitalize(), name)
    print_line(f"\ncd {folder}")
    print_line(f"robogauntlet check policy python:{name}:{title}")
    print_line(f"robogauntlet run {name}.yaml")
