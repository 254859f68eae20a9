"""Perturbs what a policy sees and does, alike in every simulator, and measures what came of it."""

from __future__ import annotations

from collections.abc import Mapping

from adapters.contract import Simulation, UnsupportedCondition
from orchestrator.perturbations.actions import Delayed, NoisyActions
from orchestrator.perturbations.arm import Started
from orchestrator.perturbations.base import Perturbed, Unperturbed
from orchestrator.perturbations.cameras import Bumped, Farther, Orbited, Widened
from orchestrator.perturbations.images import Blind, Blurred, Frozen, Noisy
from orchestrator.perturbations.lights import Dimmed, Redirected, Tinted
from orchestrator.perturbations.objects import Altered, Displaced
from orchestrator.perturbations.references import ReferenceLooks
from orchestrator.perturbations.stage import Distracted, Painted
from orchestrator.perturbations.words import Misled, Reworded, Untold
from suites.axes import axis_of
from suites.vocabulary import Episode

_PERTURBED: Mapping[str, type[Perturbed]] = {
    "camera-orbit": Orbited,
    "camera-distance": Farther,
    "field-of-view": Widened,
    "camera-bump": Bumped,
    "illuminance": Dimmed,
    "light-direction": Redirected,
    "colour-temperature": Tinted,
    "table": Painted,
    "distractors": Distracted,
    "object-position": Displaced,
    "robot-start": Started,
    "dynamics": Altered,
    "noise": Noisy,
    "blur": Blurred,
    "frozen-frames": Frozen,
    "action-noise": NoisyActions,
    "action-delay": Delayed,
    "instruction": Reworded,
    "blind": Blind,
    "blank-instruction": Untold,
    "wrong-goal": Misled,
    "again": Unperturbed,
}


def perturbed(simulation: Simulation, episode: Episode, references: ReferenceLooks | None = None) -> Simulation:
    """The simulation as this episode's condition has it: itself, or with something between it and the policy.

    Draws depend on the pair alone, so that two policies meet the same disturbance.

    Args:
        simulation: In the clean world.
        episode: Says what to change, and how much.
        references: Looks that were kept of this simulation's task.

    Raises:
        UnsupportedCondition: There is no such axis or severity.
    """
    try:
        axis = axis_of(episode.condition)
    except ValueError as error:
        raise UnsupportedCondition(str(error)) from None
    if axis is None:
        return simulation
    return _PERTURBED[axis.name](simulation, axis, episode, references)
