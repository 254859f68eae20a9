"""`robogauntlet profile`: show where the time of an episode goes, and what it could not do without."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from robogauntlet.orchestrator.cli.common import AsJson, Policies, SeedCount, Tasks, fail, out, print_json
from robogauntlet.orchestrator.episodes.profile import Profile, profile_cells
from robogauntlet.orchestrator.registry import SHIPPED, find_suite
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.references import read_reference
from robogauntlet.suites.episode import Cell
from robogauntlet.suites.selection import SuiteSelection
from robogauntlet.support.errors import BadInput

EPISODES = 3
COLUMNS = ("engine", "control", "frames", "answers", "rest", "total", "bound")


def profile(
    suite: Annotated[
        str | None,
        typer.Argument(help="A suite; by default the experts of zoo or, if they are not installed, smoke's untrained."),
    ] = None,
    policy: Policies = None,
    task: Tasks = None,
    seeds: SeedCount = None,
    as_json: AsJson = False,
) -> None:
    """Show how far an episode in each simulator is from its bound: physics, frames and answers.

    Plays the first episodes of each policy on the first task of each simulator, or on each --task, under the suite's
    first condition, in one process per simulator. The times are CPU time per episode (ms): the engine's own physics,
    the rest of the control steps (controller and adapter), frames that the policy sees, its answers, and the rest
    (reset, hashes, loop). The bound is engine + frames + answers. Exit code 1 if a simulator does not work.
    """
    from robogauntlet.orchestrator.ray_runtime.session import ray_session
    from robogauntlet.orchestrator.ray_runtime.simulator_processes import ProcessEnded, run_per_simulator

    path, default = _default_suite() if suite is None else (find_suite(suite), None)
    policy = policy or default
    plan = make_plan(path, part=SuiteSelection(tuple(policy or ()), tuple(task or ()), seeds))
    first: dict[tuple[str, str], Cell] = {}
    for cell in plan.cells:
        first.setdefault((cell.task if task else cell.simulator, cell.policy), cell)
    profiles: list[Profile] = []
    problems = [f"{name} is skipped: {reason}" for name, reason in plan.unavailable.items()]
    broken = False
    with out.status("playing"), ray_session(address=None, workers=1):
        for simulator in plan.simulators:  # one at a time, so that they do not slow each other down
            if simulator in plan.unavailable:
                continue
            cells = [cell for cell in first.values() if cell.simulator == simulator]
            arguments = (cells, dict(plan.sources), list(plan.suite.seeds)[: seeds or EPISODES])
            for _, found in run_per_simulator(profile_cells, {simulator: arguments}, plan.environments):
                if isinstance(found, ProcessEnded):
                    problems.append(f"{simulator}: {found.reason}")
                    broken = True
                else:
                    profiles.append(found)
    if as_json:
        derived = ("total", "bound", "ratio")
        print_json([asdict(row) | {name: getattr(row, name) for name in derived} for row in profiles])
    else:
        out.print(_table(profiles))
    for problem in problems:
        fail(problem)
    if broken:
        raise typer.Exit(1)


def _default_suite() -> tuple[Path, list[str]]:
    """The suite that is played by default, and its policy."""
    try:
        read_reference("zoo:experts")
    except (BadInput, PolicyError):
        return SHIPPED / "smoke.yaml", ["untrained"]
    return SHIPPED / "zoo.yaml", ["experts"]


def _table(profiles: list[Profile]) -> Table:
    table = Table("task", "policy", box=None, pad_edge=False)
    for column in ("steps", *(f"{name} ms" for name in COLUMNS), "total / bound"):
        table.add_column(column, justify="right")
    for row in profiles:
        times = (getattr(row, name) for name in COLUMNS)
        figures = ("-" if value is None else f"{value:,.0f}" for value in (row.steps, *times))
        table.add_row(row.task, row.policy, *figures, "-" if row.ratio is None else f"{row.ratio:.2f}")
    return table
