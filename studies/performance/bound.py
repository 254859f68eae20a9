"""How far an episode of the shipped experts is from its bound, in each simulator: physics, frames and answers."""

import time
from collections.abc import Iterator, Mapping, Sequence
from statistics import mean
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.ray_runtime.session import ray_session
from robogauntlet.orchestrator.ray_runtime.simulator_processes import ProcessEnded, run_per_simulator
from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.suites.episode import Cell
from robogauntlet.suites.selection import SuiteSelection
from studies.percent import few
from studies.shared import table_of

PARTS = ("engine", "control", "frames", "answers", "rest", "total", "bound")
SUITE, TASKS, SEEDS = "mergevla", ("maniskill/PushCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift"), 10


def measure() -> list[dict[str, Any]]:
    """CPU time per episode (ms), in one process per simulator."""
    plan = make_plan(find_suite(SUITE), part=SuiteSelection(("experts",), TASKS, few(SEEDS)))
    first = {cell.task: cell for cell in reversed(plan.cells)}
    rows: list[dict[str, Any]] = []
    with ray_session(address=None, workers=1):
        for task in TASKS:  # one at a time, so that they do not slow each other down
            cell = first[task]
            arguments = ([cell], dict(plan.sources), list(plan.suite.seeds))
            for _, found in run_per_simulator(parts_of_episodes, {cell.simulator: arguments}, plan.environments):
                if isinstance(found, ProcessEnded):
                    raise SystemExit(f"{task}: {found.reason}")
                rows.append(found)
    columns = {"task": "{task}", "control steps": "{steps:.0f}"} | {f"{part}, ms": f"{{{part}:.0f}}" for part in PARTS}
    table_of(rows, columns | {"total / bound": "{ratio:.2f}"})
    return rows


def parts_of_episodes(
    cells: Sequence[Cell], sources: Mapping[str, PolicySource], seeds: Sequence[int]
) -> Iterator[dict[str, Any]]:
    """CPU time per episode of each cell (ms), by part, in a process that is warm.

    Every episode is played twice: first to measure the engine in the state before each step, which may change the rest
    of the episode by rounding, then undisturbed.
    """
    for cell in cells:
        yield _parts_of_episodes(cell, sources[cell.policy], seeds)


def _parts_of_episodes(cell: Cell, source: PolicySource, seeds: Sequence[int]) -> dict[str, Any]:
    policy = build_policy(source)
    simulation: Any = catalog.open_simulation(cell.task, cell.protocol.view)
    engine_times: list[float] = []
    played = []
    for episode in map(cell.episode, seeds):
        rollout(simulation, policy, episode, watcher=lambda _, __: engine_times.append(simulation.engine_time()))
        played.append(rollout(simulation, policy, episode, clock=time.process_time))
    simulation.close()
    steps = mean(row.steps for row in played)
    physics, frames, answers, total = (
        1000 * mean(getattr(row, f"{part}_s") for row in played) for part in ("physics", "render", "inference", "wall")
    )
    engine = 1000 * steps * mean(engine_times)
    bound = engine + frames + answers
    row = {"task": cell.task, "policy": cell.policy, "steps": steps, "engine": engine, "control": physics - engine}
    row |= {"frames": frames, "answers": answers, "rest": total - physics - frames - answers, "total": total}
    return row | {"bound": bound, "ratio": total / bound}
