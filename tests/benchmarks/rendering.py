"""Rendering on demand compared with rendering after every step: the same policy, episodes and actions."""

import time

from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.catalog import load
from robogauntlet.suites.episode import View
from tests.benchmarks.shared import TASKS, episodes, open_task, table

EPISODES = 5


def measure() -> list[dict[str, object]]:
    """Episodes per hour, on demand and eager in turn, of the `untrained` policy with chunks of 8 and two cameras."""
    rows = []
    for task in TASKS:
        view = View()
        simulation, policy = open_task(task, view), load("untrained", {})
        seconds = {False: 0.0, True: 0.0}
        same = True
        rollout(simulation, policy, next(episodes(task, "untrained", view, 1)), eager=True)
        for episode in episodes(task, "untrained", view, EPISODES):
            outcomes = set()
            for eager in (False, True):
                start = time.perf_counter()
                result = rollout(simulation, policy, episode, eager=eager)
                seconds[eager] += time.perf_counter() - start
                outcomes.add((result.actions_hash, result.final_state_hash, result.status, result.steps))
            same &= len(outcomes) == 1
        simulation.close()
        rows.append(
            {
                "task": task,
                "on_demand_per_hour": 3600 * EPISODES / seconds[False],
                "eager_per_hour": 3600 * EPISODES / seconds[True],
                "ratio": seconds[True] / seconds[False],
                "identical": same,
            }
        )
    table(
        ("task", "on demand, episodes/h", "every step, episodes/h", "ratio", "identical actions and outcomes"),
        [
            (
                f["task"],
                f"{f['on_demand_per_hour']:.0f}",
                f"{f['eager_per_hour']:.0f}",
                f"{f['ratio']:.2f}",
                f["identical"],
            )
            for f in rows
        ],
    )
    return rows
