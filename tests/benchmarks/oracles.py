"""Successes of the oracles on seeds 0 to 99 of every task, and the number of steps that they need."""

import os

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.runs.plan import load_registry
from robogauntlet.results.record import Status
from robogauntlet.suites.episode import Cell, Protocol
from tests.benchmarks.shared import table_of

SEEDS = tuple(range(100))


def measure() -> list[dict[str, object]]:
    """Play each oracle on its task within the task's own horizon; nothing is rendered."""
    shown = {name for name, simulator in catalog.simulators().items() if not simulator.internal}
    for name in shown:
        os.environ.update(worker_environment(catalog.find(name)))
    runner = EpisodeRunner({"oracle": PolicySource("oracle")})
    rows = []
    for task, known in load_registry().tasks.items():
        if task.partition("/")[0] not in shown:
            continue
        results = list(runner.play(Lease(Cell("oracle", "oracle", task, Protocol(known.horizon)), SEEDS)))
        steps = [result.steps for result in results if result.status == Status.SUCCESS]
        row = {"task": task, "horizon": known.horizon, "successes": len(steps), "episodes": len(results)}
        rows.append({**row, "mean_steps": sum(steps) / max(len(steps), 1), "most_steps": max(steps, default=None)})
    runner.close()
    columns = {"task": "{task}", "horizon": "{horizon}", "successes": "{successes}/{episodes}"}
    table_of(rows, columns | {"mean steps": "{mean_steps:.1f}", "most steps": "{most_steps}"})
    return rows
