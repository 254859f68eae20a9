"""Suites that are composed of names, for runs without a suite file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from enum import StrEnum
from itertools import chain, count
from pathlib import Path
from typing import Any

import yaml

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.orchestrator.registry import load_registry
from robogauntlet.orchestrator.runs.plan import Plan, make_plan
from robogauntlet.suites.checks import MOST_SEVERE
from robogauntlet.suites.conditions import read_axis
from robogauntlet.suites.episode import CAMERAS, CLEAN
from robogauntlet.suites.loading import SuiteError
from robogauntlet.suites.registry import stored_states
from robogauntlet.suites.schema import MAX_NAME, PolicyEntry, expand_tasks, valid_name
from robogauntlet.suites.timing import Timing
from robogauntlet.support.errors import BadInput

SUITE_FILE = "suite.yaml"
"""The suite in the folder of a run without a suite file."""
SEEDS = 20
"""Number of seeds, if none is given and the tasks have as many stored states, or store none."""
RUNS = Path("runs")


def new_run_folder(suite: str) -> Path:
    """Return a path below `runs/` for a new run of the suite, by name and time. Creates nothing."""
    name = f"{suite}-{datetime.now():%Y%m%d-%H%M%S}"
    names = chain([name], (f"{name}-{number}" for number in count(2)))
    return next(path for path in map(RUNS.joinpath, names) if not path.exists())


def compose_plan(
    policies: Sequence[PolicyEntry],
    tasks: Sequence[str],
    *,
    seeds: int | None = None,
    most: int = SEEDS,
    first_seed: int = 0,
    conditions: Sequence[str] = (),
    folder: Path | None = None,
    only: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    prefix: str = "",
) -> tuple[Plan, Path]:
    """Plan a run without a suite file, and return its folder too. Writes nothing.

    Args:
        policies: The policies.
        tasks: `simulator/task`, or patterns.
        seeds: Number of seeds; by default `most`, or as many as the tasks have stored states.
        most: See `seeds`.
        first_seed: The first of them.
        conditions: `clean`, `AXIS` for all its severities, or `AXIS@SEVERITY[,SEVERITY]`; clean is always included.
        folder: The run folder; by default a new one below `runs/`.
        only: Simulators that must be available.
        settings: Further keys of the suite.
        prefix: What its name begins with, before the tasks.

    Raises:
        BadInput: Something does not exist, or is not as described; a line for each.
        PlanError: The suite cannot be run.
    """
    if seeds is None:
        known = load_registry().tasks
        seeds = min([most, *stored_states(expand_tasks(tasks, known), known)])
    if seeds < 1:
        raise BadInput(f"seeds: expected 1 or more, got {seeds}")
    name = _suite_name(tasks, prefix)
    suite: dict[str, Any] = {
        "name": name,
        "policies": [policy.model_dump(exclude_defaults=True) for policy in policies],
        "tasks": list(tasks),
        "conditions": _conditions(conditions),
        "seeds": {"start": first_seed, "count": seeds} if first_seed else {"count": seeds},
    }
    if settings and (clash := suite.keys() & settings.keys()):
        raise BadInput(
            f"{', '.join(sorted(clash))}: expected further keys of a suite, got one that other arguments give"
        )
    suite |= {"cameras": list(shared)} if (shared := _shared_cameras(tasks)) not in ((), CAMERAS) else {}
    suite |= {
        name: str(value) if isinstance(value, StrEnum | Timing) else value for name, value in (settings or {}).items()
    }
    folder = folder or new_run_folder(name)
    try:
        text = yaml.safe_dump(suite, sort_keys=False, allow_unicode=True)
        return make_plan(folder / SUITE_FILE, text=text, only=only), folder
    except yaml.representer.RepresenterError as error:
        kind = type(error.args[-1]).__name__
        raise BadInput(f"expected numbers, text, lists and mappings in a suite, got a {kind}") from None
    except SuiteError as error:
        raise BadInput("\n".join(problem.message for problem in error.problems)) from None


def _shared_cameras(tasks: Sequence[str]) -> tuple[str, ...]:
    """The cameras that all these tasks, or patterns, have. Unknown tasks are left to the suite's own checks."""
    known = task_descriptions()
    found = [known[task] for task in expand_tasks(tasks, load_registry().tasks) if task in known]
    return tuple(camera for camera in CAMERAS if all(camera in task.cameras for task in found))


def _suite_name(tasks: Sequence[str], prefix: str) -> str:
    """A name for the tasks, `pybullet-PandaReach-v3` or `pybullet-PandaReach-v3-and-2-more`."""
    more = f"-and-{len(tasks) - 1}-more" if len(tasks) > 1 else ""
    first = valid_name(tasks[0]) if tasks else ""
    return (prefix + (first or "tasks"))[: MAX_NAME - len(more)] + more


def _conditions(texts: Sequence[str]) -> list[Any]:
    """The entries of a suite. An unknown axis is left to the suite's own checks."""
    named = [read_axis(text) for text in texts if text != CLEAN]
    for text, (_, severities) in zip([text for text in texts if text != CLEAN], named, strict=True):
        if beyond := [severity for severity in severities if severity > MOST_SEVERE]:
            raise BadInput(f"condition {text}: expected a severity from 0.01 to {MOST_SEVERE}, got {beyond[0]:g}")
    return [CLEAN, *({"axis": axis, "severities": list(severities)} for axis, severities in named)]
