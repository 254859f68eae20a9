"""`robogauntlet list axes`: list perturbation axes with their severities."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.cli.common import out
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.registry import why_impossible, why_unadjusted
from robogauntlet.orchestrator.replay.first_observation import delivered_values
from robogauntlet.suites.axes import AXES, SEVERITIES
from robogauntlet.suites.axis import Axis
from robogauntlet.suites.episode import CONTROLS, Condition
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput

MEASURED = (2, 4)
"""Severities that `--delivered` measures, those of the suite `screening`."""


def list_axes(
    name: Annotated[
        str | None, typer.Argument(metavar="AXIS", help="Only this axis, such as noise, with what it does.")
    ] = None,
    delivered: Annotated[
        bool,
        typer.Option(help="Measure what severities 2 and 4 deliver in a task of each installed simulator (minutes)."),
    ] = False,
    task: Annotated[
        list[str] | None,
        typer.Option(help="With --delivered: simulator/task. Repeatable. By default the first of each simulator."),
    ] = None,
) -> None:
    """List the perturbation axes with their severities, or show one."""
    if delivered:
        _measure([_find(name)] if name else [axis for axis in AXES.values() if axis.name not in CONTROLS], task)
    elif task:
        raise BadInput("--task: expected with --delivered")
    elif name is not None:
        _show(_find(name))
    else:
        table = Table("axis", "changes", "comparable", "unit", box=None, pad_edge=False)
        for severity in range(1, SEVERITIES + 1):
            table.add_column(str(severity), justify="right")
        for axis in AXES.values():
            comparable, levels = "no" if axis.incomparable else "yes", (f"{level:g}" for level in axis.levels)
            table.add_row(axis.name, str(axis.changes), comparable, axis.unit, *levels)
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
    if axis.incomparable:
        out.print(f"not comparable between simulators: {axis.incomparable}", markup=False)
    out.print(f"aligned with: {axis.references}", markup=False)


def _measure(axes: list[Axis], task: list[str] | None) -> None:
    """Print what severities of axes deliver in a task of each simulator, and why some are not comparable."""
    environments = EnvironmentResolver()
    usable = [s for s in simulators.simulators().values() if not s.internal and not environments.missing_reason(s)]
    tasks = task or [f"{one.name}/{next(iter(one.tasks))}" for one in usable if one.tasks]
    conditions = [Condition(axis.name, severity) for axis in axes for severity in MEASURED]
    columns = []
    for name in tasks:
        known = name in simulators.task_descriptions()
        able = [one for one in conditions if not known or why_impossible(one, name) is None]
        try:
            found = dict(zip(able, delivered_values(name, able, environments), strict=True))
        except AdapterError as error:
            raise BadInput(f"{name}: {error}") from None
        columns.append([f"{value:.4g}" if (value := found.get(one)) is not None else "-" for one in conditions])
    table = Table("condition", "requested", *tasks, "comparable", box=None, pad_edge=False)
    for condition, *values in zip(conditions, *columns, strict=True):
        axis = AXES[condition.axis]
        comparable = f"no: {axis.incomparable}" if axis.incomparable else "yes"
        table.add_row(str(condition), axis.describe(condition.severity), *values, comparable)
    out.print(table)


def _find(name: str) -> Axis:
    if name not in AXES:
        of_part = [axis.name for axis in AXES.values() if name.startswith(str(axis.changes).removesuffix("s"))]
        raise BadInput(f"unknown axis '{name}'{did_you_mean(name, AXES, meant=of_part)}")
    return AXES[name]


def _describe_check(axis: Axis) -> str:
    if not axis.ordered:
        return "the task's own instruction makes the episode an error"
    if axis.tolerance == float("inf"):
        return "measured in every episode"
    return f"a deviation of more than {axis.tolerance:g} {axis.unit} makes the episode an error"
