"""What each perturbation costs: time of a perturbed episode over that of the clean one of its seed, turn by turn."""

from __future__ import annotations

import statistics

from orchestrator.plan import why_unadjusted
from orchestrator.rollout import rollout
from policies import catalog as policies
from suites.axes import AXES
from suites.vocabulary import Condition, Episode, Protocol, RenderProfile, View
from tests.benchmarks.shared import TASKS, open_task, table

SEEDS = 3
STEPS, REPLAN = 40, 4
"""An episode of the length and with the looks of a learned policy's."""
SEVERITY = 4
VIEW = View(image_size=96, render_profile=RenderProfile.FAST)


def measure() -> list[dict[str, object]]:
    """The median over seeds of the ratio, axis by axis."""
    rows: list[dict[str, object]] = []
    axes = [axis for axis in AXES.values() if not axis.is_control]
    for task in TASKS:
        simulation, policy = open_task(task, VIEW), policies.load("untrained", {})
        for axis in axes:
            if why_unadjusted(axis, task):
                continue
            ratios = []
            for seed in range(SEEDS + 1):
                seconds = []
                for condition in (Condition(), Condition(axis.name, SEVERITY)):
                    episode = Episode("untrained", "untrained", task, seed, Protocol(STEPS, REPLAN, VIEW), condition)
                    seconds.append(rollout(simulation, policy, episode).wall_s)
                ratios.append(seconds[1] / seconds[0])
            rows.append({"task": task, "axis": axis.name, "ratio": statistics.median(ratios[1:])})  # the first warms up
        simulation.close()
    found = {(row["task"], row["axis"]): f"{row['ratio']:.3f}" for row in rows}
    table(("axis", *TASKS), [(axis.name, *(found.get((task, axis.name), "-") for task in TASKS)) for axis in axes])
    return rows
