"""Processor time of a thousand of LIBERO's episodes, played by the suite's expert; before and after the speed work.

After `robogauntlet env create libero`. Opening a task and loading the expert, once per worker, are left out.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog
from robogauntlet.suites.episode import CAMERAS, Cell, Protocol, RenderProfile, View
from studies.libero.libero_experts import EXPERTS, SUITES, tasks_of
from studies.percent import few
from studies.shared import open_task, speed_up, table_of

SEEDS = range(few(3))
WAYS: Mapping[str, tuple[RenderProfile, bool, bool]] = {
    "every_step": (RenderProfile.STANDARD, False, True),
    "before": (RenderProfile.STANDARD, False, False),
    "standard": (RenderProfile.STANDARD, True, False),
    "fast-2": (RenderProfile.FAST_2, True, False),
}
"""Profile, whether frames leave out what is not seen and control steps are compiled, whether all steps are drawn."""
COLUMNS = {
    "suite": "{suite}",
    "steps": "{steps:.0f}",
    "images in every step": "{every_step:.1f}",
    "images when the policy is asked": "{before:.1f}",
    "the same with the speed work": "{standard:.1f}",
    "`fast-2`": "{fast-2:.1f}",
}


def measure() -> list[dict[str, object]]:
    """Core hours for a thousand episodes of the first task of each suite's expert, means over seeds."""
    rows: list[dict[str, object]] = []
    for suite, title in SUITES.items():
        task = tasks_of(suite)[0]
        row: dict[str, object] = {"suite": title}
        policy = catalog.load("mergevla", {"checkpoint": f"{EXPERTS}/libero-{suite}"})
        played: dict[str, list[tuple[int, str]]] = {}
        for way, (profile, quick, eager) in WAYS.items():
            view = View(CAMERAS, 96, profile)
            simulation: Any = open_task(task, view)
            speed_up(simulation, wanted=quick)
            cell = Cell("expert", "expert", task, Protocol(simulators.task_descriptions()[task].horizon, 8, view))
            started = time.process_time()
            results = [rollout(simulation, policy, cell.episode(seed), eager=eager) for seed in SEEDS]
            row[way] = (time.process_time() - started) / len(results) * 1000 / 3600
            simulation.close()
            played[way] = [(result.steps, result.actions_hash) for result in results]
        assert played["every_step"] == played["before"] == played["standard"]
        row["steps"] = sum(steps for steps, _ in played["standard"]) / len(SEEDS)
        print(row, flush=True)
        rows.append(row)
    table_of(rows, COLUMNS)
    return rows
