"""Whether `search disturbance` sees a planted delay: along `action-delay` the boundary comes nearer by as much.

`INSTRUMENT=FOLDER python -m studies instrument --measure disturbances` (default `runs/instrument`) searches, or goes on
with a search. The command has seeds of its own, from 0 and from 10,000 on.
"""

from __future__ import annotations

import json
from typing import Any

from robogauntlet.suites.axes import AXES
from studies.instrument.draws import REFERENCE, folder
from studies.shared import run_gauntlet, table_of

TASK, AXIS, BUDGET = "pybullet/PandaPickAndPlace-v3", "action-delay", 40
DEFECTIVE = ("python:defects:Defective", "--option", "folder=studies/instrument", "--option")
BUILDS = {REFERENCE: ("zoo:experts",), "a step late": (*DEFECTIVE, "options={delay: 1}")}
COLUMNS = {"build": "{build}", "half of the success is lost at a delay of": "{boundary}", "episodes": "{episodes}"}


def measure() -> list[dict[str, Any]]:
    """A row for each build: the further delay at which it loses half of its success."""
    rows = []
    for build, policy in BUILDS.items():
        out = folder() / f"search/{build.replace(' ', '-')}"
        limits = ("--task", TASK, "--axis", AXIS, "--budget", BUDGET, "--out", out)
        run_gauntlet("search", "disturbance", "--policy", *policy, *limits)
        (found,) = json.loads((out / "search.json").read_text(encoding="utf-8"))["found"]
        boundary = found["axes"][0]["boundary"]
        value, low, high = (_milliseconds(boundary[end]) for end in ("value", "low", "high"))
        rows.append({"build": build, "boundary": f"{value} ms [{low}, {high}]", "episodes": found["episodes"]})
    table_of(rows, COLUMNS)
    return rows


def _milliseconds(severity: float | None) -> str:
    axis = AXES[AXIS]
    return f">{axis.levels[-1]:.0f}" if severity is None else f"{axis.value(severity):.0f}"
