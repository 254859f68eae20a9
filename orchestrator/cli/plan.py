"""`robogauntlet plan`: show what a suite would run."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from robogauntlet.orchestrator.cli.common import (
    AsJson,
    Check,
    ImageSizeSetting,
    Policies,
    PolicyOptions,
    RenderProfileSetting,
    ReplanEvery,
    SeedCount,
    StoreUrl,
    Success,
    SuiteArgument,
    Tasks,
    WorkersSetting,
    fail,
    out,
    print_json,
    print_line,
    suite_settings,
)
from robogauntlet.orchestrator.cli.episodes_needed import (
    Asked,
    Detect,
    Discordance,
    Rate,
    Width,
    answer,
    print_answer,
)
from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.adaptive_stopping import Outcomes
from robogauntlet.orchestrator.runs.plan import check_same, fitted, make_plan, remaining_work
from robogauntlet.orchestrator.runs.suite_names import needs_policy
from robogauntlet.policies.references import read_options
from robogauntlet.results.run_document import RUN_FILE, read_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.selection import SuiteSelection
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted


def plan(
    suite: SuiteArgument,
    policy: Policies = None,
    option: PolicyOptions = None,
    task: Tasks = None,
    seeds: SeedCount = None,
    success: Success = None,
    image_size: ImageSizeSetting = None,
    replan_every: ReplanEvery = None,
    render_profile: RenderProfileSetting = None,
    workers: WorkersSetting = None,
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Folder of a run of the suite: show the episodes that it lacks.")
    ] = None,
    store: StoreUrl = None,
    width: Width = None,
    detect: Detect = None,
    rate: Rate = None,
    discordance: Discordance = None,
    check: Check = False,
    as_json: AsJson = False,
) -> None:
    """Show the episodes that a suite plans, without starting anything.

    Episodes of simulators that are not installed on this machine are shown as skipped. Nothing that a suite names is
    imported, contacted or started, unless --check is given.

    How many seeds? --width POINTS and --detect POINTS say how many an interval or a comparison needs, from the episodes
    of a run (--out) or from an assumption.
    """
    asked = Asked.from_options(width, detect, rate, discordance)
    settings = suite_settings(success, image_size, replan_every, render_profile, workers)
    part = SuiteSelection(tuple(policy or ()), tuple(task or ()), seeds, read_options(option or ()), settings)
    planned = make_plan(find_suite(suite), part=part, require_installed=False, start=check)
    if planned.suite.needs is not None:
        raise BadInput(needs_policy(planned.path, part.policies))
    done: Outcomes = {}
    if out_folder is not None and out_folder.is_file():
        raise BadInput(f"{out_folder}: expected a run folder, this is a file")
    if out_folder is not None and (out_folder / RUN_FILE).exists():
        document = read_run(out_folder)
        check_same(planned, document, out_folder)
        with closing(Store.open_begun(out_folder, document, store)) as opened:
            done = opened.outcomes()
    needed = answer(planned, asked, out_folder, store) if asked else {}
    missing = {cell: len(seeds) for cell, seeds in remaining_work(planned, done).work}
    rows = [
        {
            "task": cell.task,
            "policy": cell.policy,
            "condition": str(cell.condition),
            "horizon": cell.protocol.horizon,
            "episodes": planned.suite.seeds.count,
            "missing": "skipped" if cell.simulator in planned.unavailable else missing.get(cell, 0),
        }
        for cell in planned.cells
    ]
    total = sum(missing.values())
    if as_json:
        found = {
            "suite": planned.suite.name,
            "hash": planned.suite_hash,
            "episodes": planned.episodes,
            "to_play": total,
        }
        found |= needed | {"cells": rows, "skipped": planned.unavailable, "unchecked": planned.unchecked}
        print_json(found | {"left_out": planned.left_out, "warnings": planned.warnings})
        return
    if not needed:
        table = Table(*rows[0], box=None, pad_edge=False)
        for row in rows:
            table.add_row(*map(str, row.values()))
        out.print(table)
    play = "to play" if planned.suite.adaptive is None else "to play in the current round"
    out.print(
        f"{planned.suite.name}: {counted(planned.episodes, 'episode')}, {total:,} {play}, hash {planned.suite_hash}"
    )
    if needed:
        print_answer(needed, planned.suite.seeds.count)
    for change in fitted(planned):
        print_line(change)
    for warning in planned.warnings:
        fail(warning)
    for name, reason in planned.unavailable.items():
        fail(f"{name} is skipped: {reason}")
    for name, reason in planned.unchecked.items():
        print_line(f"note: {name} was not checked: {reason}")
