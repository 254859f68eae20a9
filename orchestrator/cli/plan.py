"""`gauntlet plan`: show what a suite would do."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from orchestrator.adaptive import Outcomes, missing
from orchestrator.cli.shared import BadInput, Policies, SeedCount, Tasks, fail, out, plan_of
from orchestrator.plan import PlanError, check_same
from results.run import RUN_FILE, RunError, read_run
from results.store import Store, StoreError
from suites.part import Part


def plan(
    suite: Annotated[str, typer.Argument(help="A suite file, or the name of a shipped suite.")],
    policy: Policies = None,
    task: Tasks = None,
    seeds: SeedCount = None,
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Run folder to continue: shows what is missing.")
    ] = None,
    store: Annotated[str | None, typer.Option(help="URL of the run's store, if it is not in the run folder.")] = None,
) -> None:
    """Show the episodes that a suite or a part of it plans, without starting anything."""
    planned = plan_of(suite, part=Part(tuple(policy or ()), tuple(task or ()), seeds))
    done: Outcomes = {}
    if out_folder is not None and out_folder.is_file():
        raise BadInput(f"{out_folder}: expected a run folder, there is a file")
    if out_folder is not None and (out_folder / RUN_FILE).exists():
        try:
            document = read_run(out_folder)
            check_same(planned, document, out_folder)
            rows = Store.open_begun(out_folder, document, store)
            done = rows.outcomes()
            rows.close()
        except (RunError, PlanError, StoreError) as error:
            raise BadInput(str(error)) from None
    lacking = {cell: len(seeds) for cell, seeds in missing(planned, done).work}
    table = Table("task", "policy", "condition", "horizon", "episodes", "missing", box=None, pad_edge=False)
    for cell in planned.cells:
        table.add_row(
            cell.task,
            cell.policy,
            str(cell.condition),
            str(cell.protocol.horizon),
            str(planned.suite.seeds.count),
            "skipped" if cell.simulator in planned.unavailable else str(lacking.get(cell, 0)),
        )
    out.print(table)
    total = sum(lacking.values())
    play = "to play" if planned.suite.adaptive is None else "to play in the round under way"
    out.print(f"{planned.suite.name}: {planned.episodes} episodes, {total} {play}, hash {planned.suite_hash}")
    for name, reason in planned.unavailable.items():
        fail(f"{name} is skipped: {reason}")
