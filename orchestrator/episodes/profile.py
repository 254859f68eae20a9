"""How far an episode is from its bound: the engine's physics, the frames that the policy sees, and its answers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import check_fit
from robogauntlet.suites.episode import Cell


@dataclass(frozen=True)
class Profile:
    """CPU time per episode of a policy on a task (ms), in a process that is warm."""

    task: str
    policy: str
    steps: float
    """Control steps per episode."""
    engine: float | None
    """The engine's own physics in these steps; None if the simulation has no `engine_time`."""
    control: float
    """The rest of the control steps: controller and adapter."""
    frames: float
    """Observing."""
    answers: float
    """The policy."""
    rest: float
    """Reset, hashes, and the loop."""

    @property
    def total(self) -> float:
        """All of it."""
        return (self.engine or 0.0) + self.control + self.frames + self.answers + self.rest

    @property
    def bound(self) -> float | None:
        """What cannot be left out: engine, frames and answers."""
        return None if self.engine is None else self.engine + self.frames + self.answers

    @property
    def ratio(self) -> float | None:
        """Total per bound."""
        return self.total / self.bound if self.bound else None


def profile_cells(
    cells: Sequence[Cell], sources: Mapping[str, PolicySource], seeds: Sequence[int]
) -> Iterator[Profile]:
    """Profile cells in this process, one after the other; see `profile_cell`."""
    for cell in cells:
        yield profile_cell(cell, sources[cell.policy], seeds)


def profile_cell(cell: Cell, source: PolicySource, seeds: Sequence[int]) -> Profile:
    """Profile a cell in this process, over the episodes of the seeds.

    Every episode is played twice: first to measure the engine in the state before each step, which may change the rest
    of the episode by rounding, then undisturbed.

    Raises:
        AdapterError: The task cannot be opened.
        PolicyError: The policy cannot be built, or does not fit.
    """
    policy = build_policy(source)
    simulation = catalog.open_simulation(cell.task, cell.protocol.view)
    measure: Callable[[], float] = getattr(simulation, "engine_time", lambda: math.nan)
    engine_times: list[float] = []
    rows = []
    try:
        check_fit(policy.spec, simulation.action_spec, simulation.observation_spec)
        for episode in map(cell.episode, seeds):
            rollout(simulation, policy, episode, watcher=lambda _, __: engine_times.append(measure()))
            rows.append(rollout(simulation, policy, episode, clock=time.process_time))
    finally:
        simulation.close()
    steps = mean(row.steps for row in rows)
    physics, frames, answers, wall = (
        1000 * mean(getattr(row, f"{phase}_s") for row in rows) for phase in ("physics", "render", "inference", "wall")
    )
    engine = 1000 * steps * mean(engine_times)
    known = not math.isnan(engine)
    return Profile(
        task=cell.task,
        policy=cell.policy,
        steps=steps,
        engine=engine if known else None,
        control=physics - engine if known else physics,
        frames=frames,
        answers=answers,
        rest=wall - physics - frames - answers,
    )
