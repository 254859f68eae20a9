"""`gauntlet axes`: the perturbation axes and their scales."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from adapters import catalog as simulators
from adapters.contract import AdapterError, Simulator
from orchestrator.cli.shared import BadInput, homes_here, out
from orchestrator.plan import why_unadjusted
from suites.axes import AXES, SEVERITIES, Axis
from suites.plugins import nearest
from suites.vocabulary import RenderProfile, View

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
    for simulator in simulators.simulators().values():
        tasks = [] if simulator.internal else [f"{simulator.name}/{task}" for task in simulator.tasks]
        reasons = {task: reason for task in tasks if (reason := why_unadjusted(found, task))}
        if len(reasons) == len(tasks) > 1 and len(set(reasons.values())) == 1:
            reasons = {f"{simulator.name}/*": reasons[tasks[0]]}
        for task, reason in reasons.items():
            out.print(f"unsupported in {task}: {reason}", markup=False, highlight=False)
    out.print(f"changes {found.changes} only; {_checked(found)}", markup=False, highlight=False)
    out.print(f"aligned with: {found.anchors}", markup=False, highlight=False)


@app.command()
def sheet(
    axis: Annotated[str, typer.Argument(help="Name or code, such as noise or N1.")],
    out_file: Annotated[Path, typer.Option("--out", help="PNG file to write.")],
    task: Annotated[
        list[str] | None,
        typer.Option(help="simulator/task. Repeatable; by default each simulator's first that can have the axis."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the episode whose first images are shown.")] = 0,
    image_size: Annotated[int, typer.Option(min=16, max=1024, help="Height and width of each image (px).")] = 128,
) -> None:
    """A contact sheet: what a policy sees in each simulator at every severity of an axis."""
    from orchestrator import contact_sheet

    found = _find(axis)
    if out_file.suffix.lower() != ".png":
        raise BadInput(f"expected a file that ends in .png for --out, got '{out_file}'")
    if out_file.is_dir() or not out_file.parent.is_dir():
        raise BadInput(f"--out: expected a file in a folder that is there, got '{out_file}'")
    homes = homes_here()
    usable = [s for s in simulators.simulators().values() if not s.internal and not homes.missing_reason(s)]
    tasks = task or [name for simulator in usable for name in _able(simulator, found)[:1]]
    if not tasks:
        raise BadInput(
            "expected a simulator, none is installed" if not usable else f"no simulator can have {found.name}"
        )
    for name in tasks:
        if name in simulators.task_cards() and (reason := why_unadjusted(found, name)):
            raise BadInput(f"axis '{found.name}' is unsupported in {name}: {reason}")
    view = View(image_size=image_size, render_profile=RenderProfile.FAST)
    rows = []
    for name in tasks:
        out.print(f"{name}: {SEVERITIES + 1} looks", markup=False, highlight=False)
        try:
            rows.append((name, contact_sheet.looks(name, found, view, seed, homes)))
        except AdapterError as error:
            raise BadInput(f"{name}: {error}") from None
    try:
        contact_sheet.sheet(found, rows).save(out_file)
    except OSError as error:
        raise BadInput(f"{out_file}: {error.strerror or error}") from None
    out.print(str(out_file), markup=False, highlight=False, soft_wrap=True)


def _able(simulator: Simulator, axis: Axis) -> list[str]:
    """Its tasks that can have an axis."""
    names = (f"{simulator.name}/{task}" for task in simulator.tasks)
    return [name for name in names if not why_unadjusted(axis, name)]


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
