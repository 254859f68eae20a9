"""Perturbs observations, actions and scenes by the same definitions in every simulator, and measures the effect."""

from __future__ import annotations

from collections.abc import Mapping

from robogauntlet.adapters.contract import Simulation, UnsupportedCondition
from robogauntlet.orchestrator.perturbations.actions import ActionDelay, ActionNoise
from robogauntlet.orchestrator.perturbations.base import Perturbed, ReferenceImages, Unperturbed
from robogauntlet.orchestrator.perturbations.cameras import CameraBump, CameraDistance, CameraOrbit, FieldOfView
from robogauntlet.orchestrator.perturbations.images import Blind, Blur, FrozenFrames, SensorNoise
from robogauntlet.orchestrator.perturbations.instructions import BlankInstruction, Instruction, WrongGoal
from robogauntlet.orchestrator.perturbations.lights import ColourTemperature, Illuminance, LightDirection
from robogauntlet.orchestrator.perturbations.physics import Dynamics, ObjectPosition, RobotStart
from robogauntlet.orchestrator.perturbations.table_and_distractors import Distractors, Table
from robogauntlet.suites.axes import axis_of
from robogauntlet.suites.episode import Episode

_PERTURBED: Mapping[str, type[Perturbed]] = {
    "camera-orbit": CameraOrbit,
    "camera-distance": CameraDistance,
    "field-of-view": FieldOfView,
    "camera-bump": CameraBump,
    "illuminance": Illuminance,
    "light-direction": LightDirection,
    "colour-temperature": ColourTemperature,
    "table": Table,
    "distractors": Distractors,
    "object-position": ObjectPosition,
    "robot-start": RobotStart,
    "dynamics": Dynamics,
    "noise": SensorNoise,
    "blur": Blur,
    "frozen-frames": FrozenFrames,
    "action-noise": ActionNoise,
    "action-delay": ActionDelay,
    "instruction": Instruction,
    "blind": Blind,
    "blank-instruction": BlankInstruction,
    "wrong-goal": WrongGoal,
    "again": Unperturbed,
}


def perturbed(simulation: Simulation, episode: Episode, references: ReferenceImages | None = None) -> Simulation:
    """The simulation under the episode's condition: itself if clean, else in a wrapper.

    Random draws depend on the pair alone, so two policies meet the same disturbance.

    Args:
        simulation: The clean simulation.
        episode: Its condition says what to change, and how much.
        references: Cached images of this simulation's task.

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
