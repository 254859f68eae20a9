"""`robogauntlet list episodes`: list the episodes of a run."""

from __future__ import annotations

from contextlib import closing
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import AsJson, NewestRunArgument, StoreUrl, newest_run, print_json, print_line
from robogauntlet.orchestrator.cli.list.names import MOST_LINES, Row, print_rows
from robogauntlet.orchestrator.replay.episode_filter import EpisodeFilter, condition_of
from robogauntlet.results.record import Status, outcome_text
from robogauntlet.results.run_document import read_run
from robogauntlet.results.store.episode_store import Store


def list_episodes(
    run: NewestRunArgument = None,
    policy: Annotated[list[str] | None, typer.Option(help="Only those of this policy, or pattern. Repeatable.")] = None,
    task: Annotated[list[str] | None, typer.Option(help="Only those in this task, or pattern. Repeatable.")] = None,
    condition: Annotated[
        list[str] | None, typer.Option(help="Only clean, noise@4, noise or a pattern. Repeatable.")
    ] = None,
    status: Annotated[list[Status] | None, typer.Option(help="Only with this outcome. Repeatable.")] = None,
    seed: Annotated[list[int] | None, typer.Option(help="Only with this seed. Repeatable.")] = None,
    store: StoreUrl = None,
    as_json: AsJson = False,
) -> None:
    """List the episodes of a run with the ids that `replay` takes."""
    folder = run or newest_run()
    chosen = EpisodeFilter(
        tuple(policy or ()), tuple(task or ()), tuple(condition or ()), tuple(map(str, status or ())), tuple(seed or ())
    )
    document = read_run(folder)
    with closing(Store.open_begun(folder, document, store)) as stored:
        found = chosen.select(document, stored.results())
    rows: list[Row] = [
        {
            "episode": row.episode_id,
            "policy": row.policy,
            "task": row.task,
            "condition": condition_of(row),
            "seed": row.seed,
            "outcome": outcome_text(row.status, row.failure),
            "steps": row.steps,
        }
        for row in found
    ]
    if as_json:
        print_json({"episodes": rows})
        return
    if rows:
        print_rows(rows[:MOST_LINES])
    if not rows or len(rows) > MOST_LINES:
        left = f"{len(rows) - MOST_LINES:,} more; choose by --policy, --task, --condition, --status or --seed"
        print_line(f"{left}, or print all by --json" if rows else f"{folder}: no episode matches the options")
