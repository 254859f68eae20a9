"""`robogauntlet list axes`: list perturbation axes and render their severities."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.contract import AdapterError, Simulator
from robogauntlet.orchestrator.cli.common import out, print_line
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.registry import why_unadjusted
from robogauntlet.suites.axes import AXES, SEVERITIES, Axis
from robogauntlet.suites.episode import RenderProfile, View
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput
from robogauntlet.support.output_file import Output

SHEET = Output("a contact sheet", re.compile(rb"\x89PNG\r\n\x1a\n.{25}.{4}tEXtSoftware\0RoboGauntlet", re.DOTALL))


def list_axes(
    name: Annotated[
        str | None, typer.Argument(metavar="AXIS", help="Only this axis, such as noise, with what it does.")
    ] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(help="PNG file to write: the first images of a task in each simulator at every severity."),
    ] = None,
    task: Annotated[
        list[str] | None,
        typer.Option(
            help="With --pictures: simulator/task. Repeatable. By default the first of each simulator that supports "
            "the axis."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="With --pictures: seed of the episode that is shown.")] = 0,
    image_size: Annotated[
        int, typer.Option(min=16, max=1024, help="With --pictures: height and width of each image (px).")
    ] = 128,
) -> None:
    """List the perturbation axes with their severities, or show one."""
    if pictures is not None:
        if name is None:
            raise BadInput("--pictures: expected the axis to draw, as in robogauntlet list axes noise --pictures FILE")
        _draw(_find(name), pictures, task, seed, image_size)
    elif task:
        raise BadInput("--task: expected with --pictures")
    elif name is not None:
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


def _draw(axis: Axis, file: Path, task: list[str] | None, seed: int, image_size: int) -> None:
    """Write a contact sheet: the first images of a task in each simulator at every severity of an axis."""
    from robogauntlet.orchestrator.replay import contact_sheet

    if file.suffix.lower() != ".png":
        raise BadInput(f"expected a file that ends in .png for --pictures, got '{file}'")
    SHEET.check(file)
    environments = EnvironmentResolver()
    usable = [s for s in simulators.simulators().values() if not s.internal and not environments.missing_reason(s)]
    tasks = task or [first for simulator in usable for first in _supporting_tasks(simulator, axis)[:1]]
    if not tasks:
        unusable = f"no installed simulator supports '{axis.name}'"
        raise BadInput(unusable if usable else "expected an installed simulator, got none")
    for task_name in tasks:
        if task_name in simulators.task_descriptions() and (reason := why_unadjusted(axis, task_name)):
            raise BadInput(f"axis '{axis.name}' is unsupported in {task_name}: {reason}")
    view = View(image_size=image_size, render_profile=RenderProfile.FAST)
    rows = []
    for task_name in tasks:
        out.print(f"{task_name}: {SEVERITIES + 1} conditions", markup=False)
        try:
            rows.append((task_name, contact_sheet.render_severities(task_name, axis, view, seed, environments)))
        except AdapterError as error:
            raise BadInput(f"{task_name}: {error}") from None
    SHEET.write(file, contact_sheet.as_png(contact_sheet.draw_contact_sheet(axis, rows)))
    print_line(str(file))


def _supporting_tasks(simulator: Simulator, axis: Axis) -> list[str]:
    """The simulator's tasks that support an axis."""
    names = (f"{simulator.name}/{task}" for task in simulator.tasks)
    return [name for name in names if not why_unadjusted(axis, name)]


def _find(name: str) -> Axis:
    if name not in AXES:
        of_part = [axis.name for axis in AXES.values() if name.startswith(str(axis.changes).removesuffix("s"))]
        raise BadInput(f"unknown axis '{name}'{did_you_mean(name, AXES, meant=of_part)}")
    return AXES[name]


def _describe_check(axis: Axis) -> str:
    if axis.tolerance == float("inf"):
        return "measured in every episode"
    return f"a deviation of more than {axis.tolerance:g} {axis.unit} makes the episode an error"
