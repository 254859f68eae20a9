"""The cost of each perturbation: duration of a perturbed episode divided by that of its clean one, alternating.

A seed's first episode under an axis may render reference images. They are cached for its later episodes, which are most
of those in a suite with several severities or policies. Both are timed.
"""

from __future__ import annotations

import statistics

from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.policies import catalog as policies
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CONTROLS, Condition, Episode, Protocol, RenderProfile, View
from studies.percent import few
from studies.shared import TASKS, open_task, table_of

SEEDS = few(5, 1)
STEPS, REPLAN = few(40, 8), 4
"""Length and observations of a typical episode of a learned policy."""
SEVERITY = 4
VIEW = View(image_size=96, render_profile=RenderProfile.FAST)


def measure() -> list[dict[str, object]]:
    """The median ratios over seeds, for each axis, of the first episode of a seed and of a later one."""
    rows: dict[str, dict[str, object]] = {name: {"axis": name} for name in AXES if name not in CONTROLS}
    for task in TASKS:
        simulation, policy = open_task(task, VIEW), policies.load("untrained", {})
        simulator = task.partition("/")[0]
        for axis, row in rows.items():
            first, later = [], []
            for seed in range(SEEDS + 1):
                references = ReferenceImages()
                clean, once, again = (
                    rollout(
                        simulation,
                        policy,
                        Episode("untrained", "untrained", task, seed, Protocol(STEPS, REPLAN, VIEW), condition),
                        references=references,
                    ).wall_s
                    for condition in (Condition(), *[Condition(axis, SEVERITY)] * 2)
                )
                first.append(once / clean)
                later.append(again / clean)
            found = statistics.median(first[1:]), statistics.median(later[1:])  # the first seed warms up
            row[f"{simulator}_first"], row[simulator] = found
            print(f"{task}: {axis} {found[0]:.3f}, {found[1]:.3f}", flush=True)
        simulation.close()
    columns = {"axis": "`{axis}`"}
    for simulator in (task.partition("/")[0] for task in TASKS):
        columns |= {simulator: f"{{{simulator}_first:.2f}}, {{{simulator}:.2f}}"}
    table_of(list(rows.values()), columns)
    return list(rows.values())
