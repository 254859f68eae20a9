"""What `search disturbance` proposed of the shipped experts, and success there on seeds that the search did not see.

`SEARCH=FOLDER python -m studies worst_cases --measure boundaries` (default `runs/boundaries`) searches, or goes on with
a search.
"""

from __future__ import annotations

import pandas as pd

from robogauntlet.results.api import open_run
from robogauntlet.results.report.formatting import span
from robogauntlet.results.statistics.boundary import Trials, is_below
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.results.statistics.worst_case import FIRST_CONFIRMATION_SEED
from robogauntlet.suites.episode import CLEAN, Condition
from studies.percent import few, folder_of
from studies.shared import run_gauntlet, table_of
from studies.tables import write_episodes

TASKS = ("maniskill/PushCube-v1", "pybullet/PandaReach-v3", "robosuite/Lift")
AXES = ("camera-bump", "object-position")
BUDGET, BELOW = few(600, 100), 0.5
EPISODE = ("task", "axis", "severity", "seed", "status")
COLUMNS = ("task", "disturbance", "success", "clean", "confirmed")


def measure() -> list[dict[str, str]]:
    """A row for each disturbance that was tested; writes the episodes beside the rows."""
    folder = folder_of("SEARCH", "boundaries")
    chosen = [
        word
        for name, values in (("--task", TASKS[: few(len(TASKS), 1)]), ("--axis", AXES))
        for one in values
        for word in (name, one)
    ]
    run_gauntlet("search", "disturbance", "--policy", "zoo:experts", *chosen, "--budget", BUDGET, "--out", folder)
    frame = pd.concat(open_run(played).episodes(EPISODE) for played in sorted(folder.glob("*/round-*")))
    write_episodes("boundaries", frame, EPISODE[:4])
    rows = rows_of(frame)
    table_of(rows, {name: f"{{{name}}}" for name in COLUMNS})
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, str]]:
    """The tests; `frame` has the columns `EPISODE`. A disturbance is compared with clean episodes of its own seeds."""
    rows = []
    tests = frame[frame["seed"] >= FIRST_CONFIRMATION_SEED]
    for (task, axis, severity), own in tests.groupby(["task", "axis", "severity"], observed=True):
        if axis == CLEAN:
            continue
        clean = tests[(tests["task"] == task) & (tests["axis"] == CLEAN) & tests["seed"].isin(own["seed"])]
        found, before = (Trials(int((one["status"] == "success").sum()), len(one)) for one in (own, clean))
        confirmed = "yes" if is_below(found, before, BELOW) else "no"
        values = task, str(Condition(axis, severity)), _rate(found), _rate(before), confirmed
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    return rows


def _rate(found: Trials) -> str:
    return f"{found.successes} of {found.trials} {span(wilson_interval(found.successes, found.trials))}"
