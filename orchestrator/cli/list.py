"""`robogauntlet list`: list what can be named in a suite, and the episodes of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import closing
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.package_files import looking_in
from robogauntlet.orchestrator.cli.common import AsJson, StoreUrl, fail, newest_run, out, print_json, print_line
from robogauntlet.orchestrator.cli.doctor import broken_plugins
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.registry import SHIPPED
from robogauntlet.orchestrator.replay.episode_filter import EpisodeFilter, condition_of
from robogauntlet.policies import catalog as policies
from robogauntlet.results.record import Status, outcome_text
from robogauntlet.results.run_document import read_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import visible

Row = dict[str, str | int | bool]


class What(StrEnum):
    """What is listed."""

    SIMULATORS = "simulators"
    TASKS = "tasks"
    POLICIES = "policies"
    SUITES = "suites"
    EPISODES = "episodes"


MOST_LINES = 200
"""Tasks of a simulator that are listed one by one, unless a pattern asks for more; and episodes of a run."""
EPISODES_ONLY = ("policy", "condition", "status", "seed", "store")


def list_names(
    what: Annotated[
        What | None, typer.Argument(help="Only these; by default tasks, policies and suites.", show_default=False)
    ] = None,
    run: Annotated[
        Path | None, typer.Argument(help="episodes: the run folder; by default the newest one under runs/.")
    ] = None,
    task: Annotated[
        list[str] | None,
        typer.Option(help="Only this task, or tasks that match a pattern, such as 'robosuite/*'. Repeatable."),
    ] = None,
    policy: Annotated[
        list[str] | None, typer.Option(help="episodes: only those of this policy, or pattern. Repeatable.")
    ] = None,
    condition: Annotated[
        list[str] | None, typer.Option(help="episodes: only clean, noise@4, noise or a pattern. Repeatable.")
    ] = None,
    status: Annotated[list[Status] | None, typer.Option(help="episodes: only with this outcome. Repeatable.")] = None,
    seed: Annotated[list[int] | None, typer.Option(help="episodes: only with this seed. Repeatable.")] = None,
    store: StoreUrl = None,
    as_json: AsJson = False,
) -> None:
    """List simulators, tasks, policies, shipped suites, or the episodes of a run.

    `robogauntlet list episodes RUN` prints the ids that `robogauntlet replay` takes.
    """
    if what is What.EPISODES:
        chosen = EpisodeFilter(
            tuple(policy or ()),
            tuple(task or ()),
            tuple(condition or ()),
            tuple(map(str, status or ())),
            tuple(seed or ()),
        )
        _list_episodes(run or newest_run(), chosen, store, as_json=as_json)
        return
    given = (policy, condition, status, seed, store)
    if wrong := next((name for name, value in zip(EPISODES_ONLY, given, strict=True) if value), None):
        raise BadInput(f"--{wrong}: expected with episodes, as in robogauntlet list episodes RUN --{wrong} ...")
    if run is not None:
        raise BadInput(f"expected no run, got '{run}'; for its episodes: robogauntlet list episodes {run}")
    if task and what not in (None, What.TASKS):
        raise BadInput(f"--task: expected with tasks or episodes, got {what}")
    wanted = (What.TASKS,) if task else (What.TASKS, What.POLICIES, What.SUITES) if what is None else (what,)
    kinds: dict[What, Callable[[], list[Row]]] = {
        What.SIMULATORS: _simulators,
        What.TASKS: lambda: _tasks(task or ()),
        What.POLICIES: _policies,
        What.SUITES: _suites,
    }
    found = {str(kind): kinds[kind]() for kind in wanted}
    if as_json:
        print_json(found)
    else:
        if not task and What.TASKS in found:
            found["tasks"] = _abbreviated(found["tasks"])
        for rows in found.values():
            out.print(_table(rows), "", sep="\n")
    for problem in broken_plugins():
        fail(problem)


def _list_episodes(folder: Path, chosen: EpisodeFilter, store: str | None, *, as_json: bool) -> None:
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
        out.print(_table(rows[:MOST_LINES]))
    if not rows or len(rows) > MOST_LINES:
        left = f"{len(rows) - MOST_LINES:,} more; choose by --policy, --task, --condition, --status or --seed"
        print_line(f"{left}, or print all by --json" if rows else f"{folder}: no episode matches the options")


def _simulators() -> list[Row]:
    environments = EnvironmentResolver()
    return [
        {
            "simulator": one.name,
            "title": one.title,
            "tasks": len(one.tasks),
            "installed": not environments.missing_reason(one),
        }
        for one in simulators.simulators().values()
        if not one.internal
    ]


def _tasks(patterns: Iterable[str]) -> list[Row]:
    environments, rows = EnvironmentResolver(), list[Row]()
    for simulator in simulators.simulators().values():
        if simulator.internal:
            continue
        environment = environments.resolve(simulator)  # Its files say what policies are told.
        shared: Row = {"simulator": simulator.title, "installed": not environments.missing_reason(simulator)}
        with looking_in(() if environment is None else environment.site_packages):
            for name, task in simulator.tasks.items():
                row: Row = {"task": f"{simulator.name}/{name}", "instruction": task.instruction}
                rows.append(row | {"horizon": task.horizon} | shared)
    names = [str(row["task"]) for row in rows]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            whole = [f"{pattern}/*"] if any(name.startswith(f"{pattern}/") for name in names) else ()
            raise BadInput(f"no task matches '{pattern}'{did_you_mean(pattern, names, meant=whole)}")
    chosen = [*patterns] or ["*"]
    return [row for row, name in zip(rows, names, strict=True) if any(fnmatchcase(name, one) for one in chosen)]


def _abbreviated(rows: list[Row]) -> list[Row]:
    """One row for all tasks of a simulator that has many."""
    counts = Counter(row["simulator"] for row in rows)
    kept: dict[str, Row] = {}
    for row in rows:
        if counts[row["simulator"]] <= MOST_LINES:
            kept[str(row["task"])] = row
            continue
        name = f"{str(row['task']).partition('/')[0]}/*"
        said = f"{counts[row['simulator']]:,} tasks: robogauntlet list --task '{name}'"
        kept.setdefault(name, row | {"task": name, "instruction": said, "horizon": ""})
    return list(kept.values())


def _policies() -> list[Row]:
    return [{"policy": kind.name, "description": kind.summary} for kind in policies.kinds().values()]


def _suites() -> list[Row]:
    import yaml

    documents = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in sorted(SHIPPED.glob("*.yaml"))}
    return [
        {"suite": name, "description": document.get("description", "").strip()} for name, document in documents.items()
    ]


def _table(rows: list[Row]) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in rows[0]:
        table.add_column(column, no_wrap=column in ("task", "episode"))
    for row in rows:
        cells = (("no", "yes")[value] if isinstance(value, bool) else str(value) for value in row.values())
        table.add_row(*(Text(visible(cell)) for cell in cells))
    return table
