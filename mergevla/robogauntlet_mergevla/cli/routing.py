"""`robogauntlet mergevla routing`: evaluate how well routers infer the task, without playing episodes."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.text import Text

from robogauntlet.orchestrator.cli.common import fail, out, print_line
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.orchestrator.live_display import Display
from robogauntlet.results.report.formatting import seconds
from robogauntlet.suites.ranges import MAX_FIRST_SEED
from robogauntlet.support.durations import format_duration
from robogauntlet.support.errors import BadInput
from robogauntlet.support.output_file import Output
from robogauntlet.support.text import counted
from robogauntlet_mergevla.cli.training_progress import needs_training_packages
from robogauntlet_mergevla.routing_evaluation.tables import (
    INSTRUCTION,
    as_json,
    confusions,
    router_table,
    split,
    unknown_table,
)

if TYPE_CHECKING:
    from robogauntlet_mergevla.routing_evaluation.evaluation import RoutingStudy

MAX_SEEDS = 100_000
STUDY = Output("results of routers", re.compile(rb'\{\n "checkpoint": [^\n]*\n "digest": '))
ROUTER_TABLE_WIDTH = 130
"""Characters that the table of routers needs in one piece."""


def routing(
    checkpoint: Annotated[
        str, typer.Argument(metavar="CHECKPOINT", help="Folder, zoo:NAME or hub id of a merged checkpoint.")
    ],
    seed_count: Annotated[
        int, typer.Option("--seeds", min=1, max=MAX_SEEDS, help="First observations per task.")
    ] = 100,
    first_seed: Annotated[
        int,
        typer.Option(min=0, max=MAX_FIRST_SEED, help="First seed. The seeds of demonstrations begin at 1,000,000."),
    ] = 0,
    keep: Annotated[
        Path | None, typer.Option(help="Folder that caches first observations, so that they are rendered once.")
    ] = None,
    demonstrations: Annotated[
        list[Path] | None,
        typer.Option(
            help="Datasets, or folders of them: each task is left out in turn and treated as unknown. Repeatable."
        ),
    ] = None,
    routers: Annotated[
        list[str] | None,
        typer.Option(
            "--router",
            metavar="NAME",
            help="Only this router, with options such as paper-coded:projections=kv,rank=16,block=2. Repeatable.",
        ),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="PATH", help="File for all results as JSON.")
    ] = None,
) -> None:
    """Evaluate routers on first observations: accuracy, calibration, latency and unknown tasks."""
    _check(keep, json_file)
    with needs_training_packages():
        import sklearn  # noqa: F401  imported late by the routers

        from robogauntlet_mergevla.routing_evaluation.evaluation import RoutingStudyRequest, study_routing
        from robogauntlet_mergevla.routing_evaluation.first_observations import FirstObservationError
    seeds = range(first_seed, first_seed + seed_count)
    request = RoutingStudyRequest(checkpoint, seeds, keep, tuple(demonstrations or ()), tuple(routers or ()))
    try:
        with StudyProgress(out) as progress:
            study = study_routing(request, progress.show)
        _show(study)
        if json_file is not None:
            STUDY.write(json_file, json.dumps(as_json(study), indent=1, allow_nan=False) + "\n")
    except FirstObservationError as error:
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(f"{error.filename or keep}: {error.strerror}") from None


class StudyProgress(Display):
    """A line with the current activity, its progress and the time left."""

    def __init__(self, console: Console, *, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(console, transient=True, now=now)
        self._activity, self._began, self._before = "", 0.0, 0

    def show(self, activity: str, done: int, wanted: int) -> None:
        """Show the latest numbers."""
        now = self._now()
        if activity != self._activity:
            self._activity, self._began, self._before = activity, now, done
        pace = (done - self._before) / (now - self._began) if now > self._began else 0.0
        left = f"  {format_duration((wanted - done) / pace)} left" if pace and done < wanted else ""
        line = f"{activity}: {done}/{wanted}{left}"
        self.draw(lambda: Text(line), lambda: [line])


def _check(keep: Path | None, json_file: Path | None) -> None:
    """Refuse options that would fail only after the work."""
    if keep is not None and keep.exists() and not keep.is_dir():
        raise BadInput(f"--keep: expected a folder, got the file '{keep}'")
    if json_file is not None:
        STUDY.check(json_file)


def _show(study: RoutingStudy) -> None:
    for name, reason in study.skipped.items():
        fail(f"{name} is skipped: {reason}")
    seeds = study.request.seeds
    extent = f"{counted(len(study.tasks), 'task')}, {counted(len(seeds), 'seed')} from {seeds[0]}"
    table, pairs = router_table(study), len(study.routers[0].quality.scene_pairs)
    title = f"Routers on first observations ({extent})"
    if pairs and out.width < ROUTER_TABLE_WIDTH:
        table, same_scene = split(table, pairs)
        out.print(rich_table(table, title=title))
        out.print()
        title, table = "Their accuracy where tasks share a scene", same_scene
    out.print(rich_table(table, title=title))
    out.print(f"one backbone pass: {seconds(study.pass_s)}, median, measured with the routers")
    if study.unfitted:
        fail("the checkpoint holds no fitted routers; merge with --demonstrations to have them")
    for router in study.routers:
        if router.quality.calibration is not None:
            lines = confusions(router.quality.confusion)
            title = f"{router.router}, instruction {INSTRUCTION[router.sees_instruction]}"
            out.print(f"{title}: {'misrouted' if lines else 'none misrouted'}")
            for line in lines:
                print_line(f"  {line}")
    for unknown in study.unknown:
        title = f"Each task unknown in turn: {unknown.router}, instruction {INSTRUCTION[unknown.sees_instruction]}"
        out.print()
        out.print(rich_table(unknown_table(unknown), title=title))
