"""`gauntlet policies demonstrate`: collect demonstrations of the oracles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from orchestrator.cli.shared import EXIT_INTERRUPTED, EXIT_STOPPED, BadInput, fail, out
from orchestrator.demonstrate import (
    FIRST_SEED,
    NOISE,
    Collected,
    DemonstrateError,
    Order,
    collect,
    folder_size,
    resolve,
)
from orchestrator.demonstration_progress import DemonstrationProgress
from orchestrator.folders import FolderError
from orchestrator.progress import format_duration
from policies.contract import PolicyError
from results.run import RunStatus
from suites.loading import SuiteError
from suites.vocabulary import RenderProfile, View


def demonstrate(
    names: Annotated[
        list[str], typer.Argument(metavar="SUITE_OR_TASKS...", help="Suites, tasks, or patterns such as 'pybullet/*'.")
    ],
    out_folder: Annotated[
        Path, typer.Option("--out", help="Folder of the datasets, one per task. What is there is kept.")
    ],
    episodes: Annotated[int, typer.Option(help="Successful episodes per task.")] = 150,
    noise: Annotated[
        float, typer.Option(help="Deviation of the executed motion, as a share of the largest in one step.")
    ] = NOISE,
    first_seed: Annotated[int, typer.Option(help="Seeds count from here. Suites count from 0.")] = FIRST_SEED,
    camera: Annotated[list[str] | None, typer.Option(help="Camera to render. Repeatable; by default both.")] = None,
    image_size: Annotated[int | None, typer.Option(help="Height and width of an image (px); by default 96.")] = None,
    render_profile: Annotated[RenderProfile | None, typer.Option(help="By default fast.")] = None,
    workers: Annotated[int, typer.Option(help="Simulator processes.")] = 2,
    learner: Annotated[
        str | None,
        typer.Option(
            metavar="EXPERTS",
            help="Folder of experts: each acts first in its task, and the oracle takes over from it (DAgger).",
        ),
    ] = None,
    whole: Annotated[
        bool, typer.Option("--whole", help="Record what the oracle would do while the learner acts, too.")
    ] = False,
) -> None:
    """Record the oracle's successes as LeRobot v3 datasets: noise in the executed action, the clean one recorded.

    Cameras, image size and render profile are the first suite's, if one is named.
    """
    try:
        tasks, suggested = resolve(names)
        view = View(
            tuple(camera) if camera else suggested.cameras,
            suggested.image_size if image_size is None else image_size,
            render_profile or suggested.render_profile,
        )
        order = Order(tasks, episodes, view, noise, first_seed, workers, learner, whole)
        with DemonstrationProgress(out) as progress:
            collected = collect(order, out_folder, progress)
    except (SuiteError, DemonstrateError, FolderError, PolicyError) as error:
        raise BadInput(str(error)) from None
    _conclude(collected, out_folder)


def _conclude(collected: Collected, folder: Path) -> None:
    table = Table("task", box=None, pad_edge=False)
    for title in ("kept", "rejected", "errors", "frames", "MB"):
        table.add_column(title, justify="right")
    table.add_column("content hash")
    for lane in collected.lanes:
        writer = lane.writer
        table.add_row(
            lane.task,
            f"{writer.episodes}/{lane.episodes}",
            *map(str, (lane.rejected, lane.errors, writer.frames)),
            f"{folder_size(writer.folder) / 1e6:.1f}",
            writer.content_hash or "",
        )
    out.print(table)
    kept = sum(lane.writer.episodes for lane in collected.lanes)
    out.print(f"{kept} episodes in {folder} after {format_duration(collected.seconds)}", markup=False, soft_wrap=True)
    for trouble in collected.troubles:
        fail(trouble)
    if collected.status is RunStatus.INTERRUPTED:
        fail("interrupted; give the same command to continue")
        raise typer.Exit(EXIT_INTERRUPTED)
    if collected.status is RunStatus.STOPPED:
        raise typer.Exit(EXIT_STOPPED)
