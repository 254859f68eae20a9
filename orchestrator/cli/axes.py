"""`gauntlet axes`: the perturbation axes and their scales."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from orchestrator.cli.shared import BadInput, out
from suites.axes import AXES, SEVERITIES, Axis
from suites.plugins import nearest

app = typer.Typer(no_args_is_help=True, help="Perturbation axes and their severities.")


@app.command("list")
def list_axes() -> None:
    """All axes, each with its value at every severity."""
    table = Table("axis", "", "changes", "unit", box=None, pad_edge=False)
    for severity in range(1, SEVERITIES + 1):
        table.add_column(str(severity), justify="right")
    for axis in AXES.values():
        table.add_row(axis.name, axis.code, str(axis.changes), axis.unit, *(f"{level:g}" for level in axis.levels))
    out.print(table)


@app.command()
def show(axis: Annotated[str, typer.Argument(help="Name or code, such as noise or N1.")]) -> None:
    """One axis: what it does, its scale, and what the scale is aligned with."""
    found = _find(axis)
    out.print(f"{found.name} ({found.code}): {found.title}", markup=False, highlight=False)
    out.print(found.summary, markup=False, highlight=False)
    table = Table("severity", box=None, pad_edge=False)
    table.add_column(found.unit, justify="right")
    for severity in range(1, SEVERITIES + 1):
        table.add_row(str(severity), f"{found.value(severity):g}")
    out.print(table)
    out.print(f"changes {found.changes} only; {_checked(found)}", markup=False, highlight=False)
    out.print(f"aligned with: {found.anchors}", markup=False, highlight=False)


def _find(name: str) -> Axis:
    by_code = {axis.code: axis for axis in AXES.values()}
    found = AXES.get(name) or by_code.get(name.upper())
    if found is None:
        raise BadInput(f"unknown axis '{name}'{nearest(name, AXES)}")
    return found


def _checked(axis: Axis) -> str:
    if axis.tolerance == float("inf"):
        return "measured in every episode"
    return f"an episode in which more than {axis.tolerance:g} {axis.unit} is amiss is an error"
