"""Rendering on demand compared with rendering after every step: the same policy, episodes and actions."""

import time

from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.catalog import load
from robogauntlet.suites.episode import View
from studies.percent import few
from studies.shared import TASKS, episodes, open_task, table_of

EPISODES = few(5, 1)


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
        on_demand, every_step = (3600 * EPISODES / seconds[which] for which in (False, True))
        row = {"task": task, "on_demand_per_hour": on_demand, "eager_per_hour": every_step}
        rows.append({**row, "ratio": seconds[True] / seconds[False], "identical": same})
    columns = {"task": "{task}", "on demand, episodes/h": "{on_demand_per_hour:.0f}"}
    columns |= {"every step, episodes/h": "{eager_per_hour:.0f}", "ratio": "{ratio:.2f}"}
    table_of(rows, columns | {"identical actions and outcomes": "{identical}"})
    return rows
