"""`robogauntlet list axes`: list perturbation axes with their severities."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.cli.common import out
from robogauntlet.orchestrator.registry import why_unadjusted
from robogauntlet.suites.axes import AXES, SEVERITIES, Axis
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput


def list_axes(
    name: Annotated[
        str | None, typer.Argument(metavar="AXIS", help="Only this axis, such as noise, with what it does.")
    ] = None,
) -> None:
    """List the perturbation axes with their severities, or show one."""
    if name is not None:
        _show(_find(name))
    else:
        table = Table("axis", "changes", "unit", box=None, pad_edge=False)
        for severity in range(1, SEVERITIES + 1):
            table.add_column(str(severity), justify="right")
        for axis in AXES.values():
            table.add_row(axis.name, str(axis.changes), axis.unit, *(f"{level:g}" for level in axis.levels))
        out.print(table)


def _show(axis: Axis) -> None:
    """Print what an axis changes, its severities and the published values they are aligned with."""
    out.print(f"{axis.name}: {axis.summary}", markup=False)
    table = Table("severity", box=None, pad_edge=False)
    table.add_column(axis.unit, justify="right")
    for severity, level in enumerate(axis.levels, start=1):
        table.add_row(str(severity), f"{level:g}")
    out.print(table)
    for simulator in simulators.simulators().values():
        tasks = [] if simulator.internal else [f"{simulator.name}/{task}" for task in simulator.tasks]
        reasons = {task: reason for task in tasks if (reason := why_unadjusted(axis, task))}
        if len(reasons) == len(tasks) > 1 and len(set(reasons.values())) == 1:
            reasons = {f"{simulator.name}/*": reasons[tasks[0]]}
        for task, reason in reasons.items():
            out.print(f"unsupported in {task}: {reason}", markup=False)
    out.print(f"changes {axis.changes} only; {_describe_check(axis)}", markup=False)
    out.print(f"aligned with: {axis.references}", markup=False)


def _find(name: str) -> Axis:
    if name not in AXES:
        of_part = [axis.name for axis in AXES.values() if name.startswith(str(axis.changes).removesuffix("s"))]
        raise BadInput(f"unknown axis '{name}'{did_you_mean(name, AXES, meant=of_part)}")
    return AXES[name]


def _describe_check(axis: Axis) -> str:
    if axis.tolerance == float("inf"):
        return "measured in every episode"
    return f"a deviation of more than {axis.tolerance:g} {axis.unit} makes the episode an error"
