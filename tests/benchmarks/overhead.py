"""The cost of each perturbation: duration of a perturbed episode divided by that of its clean one, alternating.

A seed's first episode under an axis may render reference images. They are cached for its later episodes, which are most
of those in a suite with several severities or policies. Both are timed."""

from __future__ import annotations

import statistics

from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.orchestrator.runs.plan import why_unadjusted
from robogauntlet.policies import catalog as policies
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CONTROLS, Condition, Episode, Protocol, RenderProfile, View
from tests.benchmarks.shared import TASKS, open_task, table

SEEDS = 5
STEPS, REPLAN = 40, 4
"""Length and observations of a typical episode of a learned policy."""
SEVERITY = 4
VIEW = View(image_size=96, render_profile=RenderProfile.FAST)


def measure() -> list[dict[str, object]]:
    """The median ratio over seeds, for each axis."""
    rows: list[dict[str, object]] = []
    axes = [axis for axis in AXES.values() if axis.name not in CONTROLS]
    for task in TASKS:
        simulation, policy = open_task(task, VIEW), policies.load("untrained", {})
        for axis in axes:
            if why_unadjusted(axis, task):
                continue
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
                    for condition in (Condition(), *[Condition(axis.name, SEVERITY)] * 2)
                )
                first.append(once / clean)
                later.append(again / clean)
            ratios = {"ratio_first": statistics.median(first[1:]), "ratio": statistics.median(later[1:])}
            rows.append({"task": task, "axis": axis.name, **ratios})  # the first seed warms up
            print(f"{task}: {axis.name} {ratios['ratio_first']:.3f}, {ratios['ratio']:.3f}", flush=True)
        simulation.close()
    found = {(row["task"], row["axis"]): f"{row['ratio_first']:.3f}, {row['ratio']:.3f}" for row in rows}
    print("first episode of a seed, later ones")
    table(("axis", *TASKS), [(axis.name, *(found.get((task, axis.name), "-") for task in TASKS)) for axis in axes])
    return rows
