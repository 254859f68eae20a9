"""The first observation of an episode under a condition, without a policy."""

from __future__ import annotations

from robogauntlet.adapters.contract import Observation, Simulation
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import PerturbedSimulation
from robogauntlet.orchestrator.replay.media_selection import Snapshot
from robogauntlet.suites.episode import Episode, Protocol


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
