"""`gauntlet policies routing`: how well each router infers the task, without playing episodes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.text import Text

from orchestrator.cli.policies.training import needs_training_packages
from orchestrator.cli.shared import BadInput, fail, out
from orchestrator.cli.tables import rich_table
from orchestrator.display import Display
from orchestrator.progress import format_duration
from orchestrator.routing_tables import (
    INSTRUCTION,
    as_json,
    confusions,
    router_table,
    scene_pairs,
    split,
    unknown_table,
)
from policies.contract import PolicyError
from results.report.text import seconds

if TYPE_CHECKING:
    from orchestrator.routing_study import RoutingStudy

MOST_SEEDS = 100_000
WIDE = 130
"""Characters for the whole table of routers in one."""


def routing(
    checkpoint: Annotated[str, typer.Argument(metavar="CHECKPOINT", help="A merged checkpoint's folder or hub id.")],
    seed_count: Annotated[int, typer.Option("--seeds", help="Episodes to look at, per task.")] = 100,
    first_seed: Annotated[int, typer.Option(help="Seeds count from here. Demonstrations count from 1,000,000.")] = 0,
    keep: Annotated[
        Path | None, typer.Option(help="Folder to keep first observations in; what is there is not looked at again.")
    ] = None,
    demonstrations: Annotated[
        list[Path] | None,
        typer.Option(help="Datasets, or folders of them: leave each task out in turn, as unknown. Repeatable."),
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", metavar="PATH", help="Write all of it there.")] = None,
) -> None:
    """Put every router to the test on first observations: accuracy, calibration, latency, and what is unknown."""
    _check(seed_count, first_seed, keep, json_file)
    with needs_training_packages():
        import sklearn  # noqa: F401  needed by what imports it late

        from orchestrator.routing_study import Order, study_routing
        from orchestrator.sighting import SightingError
    order = Order(checkpoint, range(first_seed, first_seed + seed_count), keep, tuple(demonstrations or ()))
    try:
        with StudyProgress(out) as progress:
            study = study_routing(order, progress.show)
        _show(study)
        if json_file is not None:
            json_file.write_text(json.dumps(as_json(study), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except (PolicyError, SightingError) as error:
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(f"{error.filename or keep}: {error.strerror}") from None


class StudyProgress(Display):
    """One line that says what is being done, how far it is and how long it takes still."""

    def __init__(self, console: Console, *, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(console, transient=True, now=now)
        self._what, self._began, self._before = "", 0.0, 0

    def show(self, what: str, done: int, wanted: int) -> None:
        """Refresh what is shown."""
        now = self._now()
        if what != self._what:
            self._what, self._began, self._before = what, now, done
        pace = (done - self._before) / (now - self._began) if now > self._began else 0.0
        left = f"  {format_duration((wanted - done) / pace)} left" if pace and done < wanted else ""
        line = f"{what}: {done}/{wanted}{left}"
        self.draw(lambda: Text(line), lambda: [line])


def _check(count: int, first_seed: int, keep: Path | None, json_file: Path | None) -> None:
    """Refuse at once what would fail after the work."""
    if not 1 <= count <= MOST_SEEDS:
        raise BadInput(f"--seeds: expected 1 to {MOST_SEEDS}, got {count}")
    if not 0 <= first_seed <= 2**62:
        raise BadInput(f"--first-seed: expected 0 to 2^62, got {first_seed}")
    if keep is not None and keep.exists() and not keep.is_dir():
        raise BadInput(f"--keep: expected a folder, got the file '{keep}'")
    if json_file is not None and (json_file.is_dir() or not json_file.parent.is_dir()):
        raise BadInput(f"--json: expected a file in a folder that is there, got '{json_file}'")


def _show(study: RoutingStudy) -> None:
    for name, reason in study.skipped.items():
        fail(f"{name} is skipped: {reason}")
    looked = f"{len(study.tasks)} tasks, {len(study.order.seeds)} seeds from {study.order.seeds[0]}"
    table, pairs = router_table(study), len(scene_pairs(study.tasks))
    title = f"Routers on first observations ({looked})"
    if pairs and out.width < WIDE:
        table, alone = split(table, pairs)
        out.print(rich_table(table, title=title))
        out.print()
        title, table = "Their accuracy where tasks share a scene", alone
    out.print(rich_table(table, title=title))
    out.print(f"one backbone pass: {seconds(study.judgement.pass_s)}, median, measured beside the routers")
    if study.unfitted:
        fail("the checkpoint holds no fitted routers; merge with --demonstrations to have them")
    for one in study.judgement.routers:
        if one.study.calibrated is not None:
            lines = confusions(one.study)
            title = f"{one.router}, instruction {INSTRUCTION[one.sees_instruction]}"
            out.print(f"{title}: {'misrouted' if lines else 'none misrouted'}")
            for line in lines:
                out.print(f"  {line}", markup=False, soft_wrap=True)
    for unknown in study.unknown:
        title = f"Each task unknown in turn: {unknown.router}, instruction {INSTRUCTION[unknown.sees_instruction]}"
        out.print()
        out.print(rich_table(unknown_table(unknown.left_out), title=title))
