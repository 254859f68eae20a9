"""The first observation of an episode under a condition, and what axes deliver in a task, without a policy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import AdapterError, Observation, Simulation
from robogauntlet.adapters.motion import standing_still
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import PerturbedSimulation
from robogauntlet.orchestrator.replay.media_selection import Snapshot
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.axis import Changes
from robogauntlet.suites.episode import Condition, Episode, Protocol, RenderProfile, View

STEPS, REPLAN_EVERY = 48, 8
"""Control steps of an episode in which an axis of images or actions is measured, and those between observations."""


def first_observation(simulation: Simulation, snapshot: Snapshot) -> Observation:
    """The observation, with the instruction, that a policy gets after the reset.

    Raises:
        AdapterError: The task does not support the axis, or the severity was not delivered.
    """
    protocol = Protocol(1, 1, snapshot.view)
    episode = Episode("snapshot", "snapshot", snapshot.task, snapshot.seed, protocol, snapshot.condition)
    simulation = perturbed(simulation, episode)
    simulation.reset(snapshot.seed)
    observation = simulation.observe()
    if isinstance(simulation, PerturbedSimulation):
        simulation.delivered()  # raises if the severity was not delivered
    return observation


def delivered_values(
    task: str, conditions: Iterable[Condition], environments: EnvironmentResolver
) -> list[float | None]:
    """Return what each condition, of one axis, delivers in a task to a robot that stays in place; None if nothing.

    Raises:
        AdapterError: The task cannot be opened.
    """
    from robogauntlet.orchestrator.ray_runtime.simulator_processes import run_in_simulator_environment  # imports Ray

    simulator, arguments = catalog.find(task.partition("/")[0]), (task, tuple(conditions))
    return run_in_simulator_environment(_measure, simulator, arguments, environments)


def _measure(task: str, conditions: Iterable[Condition]) -> Iterator[float | None]:
    protocol = Protocol(STEPS, REPLAN_EVERY, View(render_profile=RenderProfile.FAST))
    simulation = catalog.open_simulation(task, protocol.view)
    try:
        for condition in conditions:
            one = perturbed(simulation, Episode("delivered", "delivered", task, 0, protocol, condition))
            assert isinstance(one, PerturbedSimulation)
            try:
                one.reset(0)
                long = AXES[condition.axis].changes in (Changes.IMAGES, Changes.ACTIONS)
                for step in range(STEPS if long else 1):
                    if step % REPLAN_EVERY == 0:
                        one.observe()
                    one.step(standing_still(one))
                yield one.delivered().value
            except AdapterError:
                yield None
    finally:
        simulation.close()
