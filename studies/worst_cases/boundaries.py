"""The smallest disturbances that break the shipped experts, in a task of each simulator: what `search` finds.

`SEARCH=FOLDER python -m studies worst_cases --measure boundaries` (default `runs/boundaries`) searches, or goes on with
a search.
"""

from __future__ import annotations

import os
from pathlib import Path

import pandas as pd

from robogauntlet.orchestrator.runs.worst_case_search import condition_at
from robogauntlet.results.api import open_run
from robogauntlet.results.report.worst_cases import boundary_table, confirmation_table
from robogauntlet.results.statistics.worst_case import (
    Answer,
    Round,
    SearchSpace,
    Trials,
    WorstCases,
    search_worst_cases,
)
from studies.shared import run_gauntlet, table_of
from studies.tables import write_episodes

TASKS = ("maniskill/PushCube-v1", "pybullet/PandaReach-v3", "robosuite/Lift")
AXES = ("camera-bump", "object-position")
BUDGET, BELOW = 600, 0.5
EPISODE = ("task", "axis", "severity", "seed", "status")
COLUMNS = {"boundary": "{boundary}"} | {task: f"{{{task}}}" for task in TASKS}


def measure() -> list[dict[str, str]]:
    """A row for each boundary and each test of it; writes the episodes beside the rows."""
    folder = Path(os.environ.get("SEARCH", "runs/boundaries")).absolute()
    chosen = [word for name, values in (("--task", TASKS), ("--axis", AXES)) for one in values for word in (name, one)]
    run_gauntlet("search", "disturbance", "--policy", "zoo:experts", *chosen, "--budget", BUDGET, "--out", folder)
    frame = pd.concat(open_run(played).episodes(EPISODE) for played in sorted(folder.glob("*/round-*")))
    write_episodes("boundaries", frame, EPISODE[:4])
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, str]]:
    """Boundaries and tests; `frame` has the columns `EPISODE`, from which the search is gone through again."""
    found = {task: _searched(frame[frame.task == task]) for task in TASKS}
    boundaries = boundary_table(found)
    rows = [dict(zip(boundaries.header, row, strict=True)) for row in boundaries.rows]
    tested: dict[str, dict[str, str]] = {}
    for task, point, _, success, _, verdict in confirmation_table(found, BELOW).rows:
        what = "combined" if "+" in str(point) else str(point).partition("@")[0]
        tested.setdefault(what, {})[str(task)] = f"{point}: {success}, {verdict}"
    rows += [{"boundary": f"{what}, tested", **dict.fromkeys(TASKS, ""), **cells} for what, cells in tested.items()]
    return [{name: str(cell) for name, cell in row.items()} for row in rows]


def _searched(played: pd.DataFrame) -> WorstCases:
    rounds = search_worst_cases(SearchSpace(AXES, (), lambda names: True), BUDGET // len(TASKS), below=BELOW)
    try:
        asked = next(rounds)
        while True:
            asked = rounds.send(_answer(played, asked))
    except StopIteration as end:
        found: WorstCases = end.value
        return found


def _answer(played: pd.DataFrame, asked: Round) -> Answer:
    answer = {}
    for point in asked.points:
        condition = condition_at(point)
        inside = (played.axis == condition.axis) & (played.severity == condition.severity)
        statuses = list(played[inside & played.seed.isin(asked.seeds)].drop_duplicates("seed").status)
        won = statuses.count("success")
        answer[point] = Trials(won, won + statuses.count("failure"))
    return answer
