"""`robogauntlet new demonstrations`: record demonstrations of the oracles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from robogauntlet.orchestrator.cli.common import EXIT_INTERRUPTED, EXIT_STOPPED, fail, out, print_line
from robogauntlet.orchestrator.demonstrations.collect import (
    NOISE,
    CollectionRequest,
    CollectionResult,
    collect,
    folder_size,
    resolve,
)
from robogauntlet.orchestrator.demonstrations.progress import DemonstrationProgress
from robogauntlet.orchestrator.demonstrations.variation import Variation
from robogauntlet.results.run_document import RunStatus
from robogauntlet.suites.episode import FIRST_TRAINING_SEED, RenderProfile, View
from robogauntlet.support.durations import format_duration
from robogauntlet.support.text import counted


def new(
    names: Annotated[
        list[str], typer.Argument(metavar="SUITE_OR_TASKS", help="Suites, tasks, or patterns such as 'pybullet/*'.")
    ],
    out_folder: Annotated[
        Path, typer.Option("--out", help="Folder of the datasets, one per task. Existing episodes are kept.")
    ],
    episodes: Annotated[int, typer.Option(help="Successful episodes per task.")] = 150,
    noise: Annotated[
        float, typer.Option(help="Noise added to the executed motion, as a share of the largest motion of a step.")
    ] = NOISE,
    first_seed: Annotated[int, typer.Option(help="First seed. The seeds of suites begin at 0.")] = FIRST_TRAINING_SEED,
    camera: Annotated[
        list[str] | None, typer.Option(help="Camera to render. Repeatable; by default both cameras.")
    ] = None,
    image_size: Annotated[int | None, typer.Option(help="Height and width of an image (px); by default 96.")] = None,
    render_profile: Annotated[RenderProfile | None, typer.Option(help="Render profile; by default fast.")] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="AXIS[@SEVERITY]",
            help="Axis that half of the episodes have, at a random severity up to this one (2). Repeatable.",
        ),
    ] = None,
    workers: Annotated[int, typer.Option(help="Largest number of simulator processes.")] = 2,
    learner: Annotated[
        str | None,
        typer.Option(
            metavar="POLICY",
            help="Policy that acts first, then the oracle takes over (DAgger), such as a folder of experts.",
        ),
    ] = None,
    whole: Annotated[
        bool, typer.Option("--whole", help="With --learner: also record the oracle's actions while the learner acts.")
    ] = False,
) -> None:
    """Record successful episodes of the oracles as datasets.

    The format is LeRobot's, version 3. The executed actions contain noise, the recorded ones do not. Cameras, image
    size and render profile are by default those of the first suite that is named.
    """
    tasks, suggested = resolve(names)
    view = View(
        tuple(camera) if camera else suggested.cameras,
        suggested.image_size if image_size is None else image_size,
        render_profile or suggested.render_profile,
    )
    request = CollectionRequest(
        tasks, episodes, view, noise, first_seed, workers, learner, whole, Variation.read(vary or ())
    )
    with DemonstrationProgress(out) as progress:
        collected = collect(request, out_folder, progress)
    _conclude(collected, out_folder)


def _conclude(collected: CollectionResult, folder: Path) -> None:
    table = Table("task", box=None, pad_edge=False)
    for title in ("kept", "rejected", "errors", "frames", "MB"):
        table.add_column(title, justify="right")
    table.add_column("content hash")
    for task in collected.tasks:
        writer = task.writer
        table.add_row(
            task.name,
            f"{writer.episodes}/{task.episodes}",
            *map(str, (task.rejected, task.errors, writer.frames)),
            f"{folder_size(writer.folder) / 1e6:.1f}",
            writer.content_hash or "",
        )
    out.print(table)
    kept = sum(task.writer.episodes for task in collected.tasks)
    print_line(f"{counted(kept, 'episode')} in {folder} after {format_duration(collected.seconds)}")
    for warning in collected.warnings:
        fail(warning)
    if collected.status is RunStatus.INTERRUPTED:
        fail("interrupted; give the same command to continue")
        raise typer.Exit(EXIT_INTERRUPTED)
    if collected.status is RunStatus.STOPPED:
        raise typer.Exit(EXIT_STOPPED)
