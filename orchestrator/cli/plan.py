"""`robogauntlet plan`: show what a suite would run, or check suites."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from robogauntlet.orchestrator.cli.common import (
    EXIT_BAD_INPUT,
    AsJson,
    ImageSizeSetting,
    Latency,
    Policies,
    PolicyOptions,
    RenderProfileSetting,
    ReplanEvery,
    SeedCount,
    StoreUrl,
    Success,
    Tasks,
    WorkersSetting,
    fail,
    out,
    print_json,
    print_line,
    refuse,
    suite_settings,
)
from robogauntlet.orchestrator.cli.episodes_needed import Asked, Detect, Discordance, Rate, Width, answer, print_answer
from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.adaptive_stopping import Outcomes
from robogauntlet.orchestrator.runs.plan import Plan, check_same, fitted, make_plan, remaining_work
from robogauntlet.orchestrator.runs.suite_names import PlanError, needs_policy
from robogauntlet.policies.references import read_options
from robogauntlet.results.run_document import RUN_FILE, read_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.loading import SuiteError
from robogauntlet.suites.selection import SuiteSelection
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted


def plan(
    suites: Annotated[
        list[str],
        typer.Argument(
            metavar="SUITE", help="A suite file, or the name of a shipped suite; several of them with --check."
        ),
    ],
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Only check the suites: report every mistake with its line, and what is missing here."
        ),
    ] = False,
    start: Annotated[
        bool,
        typer.Option(
            "--start", help="Import the code that the suite names, contact its policy servers, as a run does."
        ),
    ] = False,
    policy: Policies = None,
    option: PolicyOptions = None,
    task: Tasks = None,
    seeds: SeedCount = None,
    success: Success = None,
    image_size: ImageSizeSetting = None,
    replan_every: ReplanEvery = None,
    render_profile: RenderProfileSetting = None,
    workers: WorkersSetting = None,
    latency: Latency = None,
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Folder of a run of the suite: show the episodes that it lacks.")
    ] = None,
    store: StoreUrl = None,
    width: Width = None,
    detect: Detect = None,
    rate: Rate = None,
    discordance: Discordance = None,
    as_json: AsJson = False,
) -> None:
    """Show the episodes of a suite, starting nothing, or check suites.

    Episodes of simulators that are not installed on this machine are shown as skipped. Nothing that a suite names is
    imported, contacted or started, unless --start is given.

    How many seeds? --width POINTS and --detect POINTS say how many an interval or a comparison needs, from the episodes
    of a run (--out) or from an assumption.
    """
    asked = Asked.from_options(width, detect, rate, discordance)
    settings = suite_settings(success, image_size, replan_every, render_profile, workers, latency)
    part = SuiteSelection(tuple(policy or ()), tuple(task or ()), seeds, read_options(option or ()), settings)
    if check:
        refuse("--check", {"--out": out_folder, "--store": store, "--width": width, "--detect": detect})
        _check(suites, part, start=start, as_json=as_json)
        return
    if len(suites) > 1:
        raise BadInput(f"expected one suite, got {len(suites)}; to check several: robogauntlet plan --check SUITE...")
    planned = make_plan(find_suite(suites[0]), part=part, require_installed=False, start=start)
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
    needed = answer(planned, asked, out_folder, store) if asked else []
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
        found |= ({"seeds_needed": needed} if asked else {}) | {
            "cells": rows,
            "skipped": planned.unavailable,
            "unchecked": planned.unchecked,
        }
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


def _check(suites: list[str], part: SuiteSelection, *, start: bool, as_json: bool) -> None:
    """Report every mistake of suites with its line; exit if there is one."""
    found: list[dict[str, Any]] = []
    for suite in suites:
        try:
            plan = make_plan(find_suite(suite), part=part, require_installed=False, start=start)
        except (SuiteError, PlanError) as error:
            found.append({"suite": suite, "mistakes": str(error).splitlines()})
        else:
            numbers = {"episodes": plan.episodes, "hash": plan.suite_hash}
            found.append({"suite": str(plan.path), "mistakes": [], **numbers, "notes": list(_notes(plan))})
    if as_json:
        print_json(found)
    for row in [] if as_json else found:
        for mistake in row["mistakes"]:
            fail(mistake)
        if not row["mistakes"]:
            print_line(f"{row['suite']}: valid, {counted(row['episodes'], 'episode')}, hash {row['hash']}")
            for note in row["notes"]:
                print_line(f"  note: {note}")
    if any(row["mistakes"] for row in found):
        raise typer.Exit(EXIT_BAD_INPUT)


def _notes(plan: Plan) -> Iterator[str]:
    """What is missing in the suite or on this machine."""
    if plan.suite.needs is not None:
        suite = plan.suite
        episodes = len(suite.tasks) * len(suite.all_conditions()) * suite.seeds.count * (1 + len(suite.policies))
        yield f"needs a policy, to play {counted(episodes, 'episode')}; add --policy to robogauntlet run"
    yield from plan.notes
    yield from plan.warnings
    for simulator, reason in plan.unavailable.items():
        yield f"simulator {simulator}: {reason}"
    if plan.unchecked:
        names = ", ".join(list(plan.unchecked)[:3]) + (", ..." if len(plan.unchecked) > 3 else "")
        reasons = "; ".join(dict.fromkeys(plan.unchecked.values()))
        yield f"not checked whether the policies {names} fit the suite: {reasons}"
