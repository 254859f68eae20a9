"""Share of an episode's time in which its behaviour is measured: of the experts, which look, and of the oracles."""

from __future__ import annotations

import time

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.episodes.behaviour import BehaviourMeter
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog as policies
from robogauntlet.suites.episode import Episode, Protocol
from tests.benchmarks.shared import EXPERT_VIEW, EXPERTS, POLICY_OPTIONS, TASKS, open_task, table_of

SEEDS = range(1, 11)


def measure() -> list[dict[str, object]]:
    """Play ten episodes of each policy in a task of each simulator, after one that warms up."""
    rows = []
    sample, columns, spent = BehaviourMeter.sample, BehaviourMeter.columns, 0.0

    def timed_sample(meter: BehaviourMeter) -> None:
        nonlocal spent
        start = time.perf_counter()
        sample(meter)
        spent += time.perf_counter() - start

    def timed_columns(meter: BehaviourMeter, status: object) -> object:
        nonlocal spent
        start = time.perf_counter()
        found = columns(meter, status)  # type: ignore[arg-type]
        spent += time.perf_counter() - start
        return found

    BehaviourMeter.sample, BehaviourMeter.columns = timed_sample, timed_columns  # type: ignore[method-assign,assignment]
    for task in TASKS:
        simulation, horizon = open_task(task, EXPERT_VIEW), catalog.task_descriptions()[task].horizon
        for name, kind, options in (("experts", EXPERTS, POLICY_OPTIONS[EXPERTS]), ("oracle", "oracle", {})):
            policy = policies.load(kind, options)
            protocol = Protocol(horizon, 4 if kind == EXPERTS else 1, EXPERT_VIEW)
            rollout(simulation, policy, Episode(name, name, task, 0, protocol))
            spent = 0.0
            played = [rollout(simulation, policy, Episode(name, name, task, seed, protocol)) for seed in SEEDS]
            wall, steps = sum(row.wall_s for row in played), sum(row.steps for row in played)
            rows.append({"task": task, "policy": name, "us": spent / steps * 1e6, "share": spent / wall})
        simulation.close()
    table_of(rows, {"task": "{task}", "policy": "{policy}", "µs per step": "{us:.0f}", "of the episode": "{share:.2%}"})
    return rows
