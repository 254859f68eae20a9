"""Share of an episode's time in which its behaviour is measured: of the experts, which look, and of the oracles."""

from __future__ import annotations

import time
from itertools import product

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.episodes.behaviour import BehaviourMeter
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog as policies
from robogauntlet.suites.episode import Episode, Protocol, RenderProfile, View
from studies.percent import few
from studies.shared import EXPERTS, POLICY_OPTIONS, TASKS, open_task, table_of

SEEDS = range(1, 11)
PLAYED = (
    ("experts, `fast`", EXPERTS, RenderProfile.FAST),
    ("experts, `fast-2`", EXPERTS, RenderProfile.FAST_2),
    ("oracle", "oracle", RenderProfile.FAST),
)
"""Name, kind of policy, render profile."""


def measure() -> list[dict[str, object]]:
    """Play ten episodes of each policy in a task of each simulator, after one that warms up."""
    rows: list[dict[str, object]] = []
    sample, columns, spent = BehaviourMeter.sample, BehaviourMeter.columns, 0.0

    def timed_sample(meter: BehaviourMeter) -> None:
        nonlocal spent
        start = time.perf_counter()
        sample(meter)
        spent += time.perf_counter() - start

    def timed_columns(meter: BehaviourMeter, *ending: object) -> object:
        nonlocal spent
        start = time.perf_counter()
        found = columns(meter, *ending)  # type: ignore[arg-type]
        spent += time.perf_counter() - start
        return found

    BehaviourMeter.sample, BehaviourMeter.columns = timed_sample, timed_columns  # type: ignore[method-assign,assignment]
    for task, (name, kind, profile) in product(TASKS, PLAYED):
        view = View(render_profile=profile)
        simulation, protocol = open_task(task, view), Protocol(catalog.task_descriptions()[task].horizon, view=view)
        policy = policies.load(kind, POLICY_OPTIONS.get(kind, {}))
        rollout(simulation, policy, Episode(name, name, task, 0, protocol))
        spent = 0.0
        played = [
            rollout(simulation, policy, Episode(name, name, task, seed, protocol)) for seed in SEEDS[: few(len(SEEDS))]
        ]
        wall, steps = sum(row.wall_s for row in played), sum(row.steps for row in played)
        rows.append({"task": task, "policy": name, "us": spent / steps * 1e6, "share": spent / wall})
        simulation.close()
    table_of(rows, {"task": "{task}", "policy": "{policy}", "µs per step": "{us:.0f}", "of the episode": "{share:.2%}"})
    return rows
