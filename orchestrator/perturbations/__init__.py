"""Perturbs observations, actions and scenes by the same definitions in every simulator, and measures the effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from robogauntlet.adapters.contract import Simulation, UnsupportedCondition
from robogauntlet.orchestrator.perturbations.actions import ActionDelay, ActionNoise, AnswerLatency
from robogauntlet.orchestrator.perturbations.base import Perturbed, ReferenceImages, Unperturbed
from robogauntlet.orchestrator.perturbations.cameras import CameraBump, CameraDistance, CameraOrbit, FieldOfView
from robogauntlet.orchestrator.perturbations.combination import Combination
from robogauntlet.orchestrator.perturbations.images import Blind, Blur, FrozenFrames, SensorNoise
from robogauntlet.orchestrator.perturbations.instructions import BlankInstruction, Instruction, VariantName, WrongGoal
from robogauntlet.orchestrator.perturbations.lights import ColourTemperature, Illuminance, LightDirection
from robogauntlet.orchestrator.perturbations.physics import Dynamics, ObjectPosition, Resampled, RobotStart
from robogauntlet.orchestrator.perturbations.table_and_distractors import Distractors, Table
from robogauntlet.suites.axes import LATENCY, axes_of
from robogauntlet.suites.episode import Condition, Episode, Perturbation

_PERTURBED: Mapping[str, type[Perturbed]] = {
    "object-position": ObjectPosition,
    "robot-start": RobotStart,
    "dynamics": Dynamics,
    "distractors": Distractors,
    "camera-orbit": CameraOrbit,
    "camera-distance": CameraDistance,
    "field-of-view": FieldOfView,
    "camera-bump": CameraBump,
    "table": Table,
    "light-direction": LightDirection,
    "illuminance": Illuminance,
    "colour-temperature": ColourTemperature,
    "blur": Blur,
    "noise": SensorNoise,
    "frozen-frames": FrozenFrames,
    "action-noise": ActionNoise,
    "action-delay": ActionDelay,
    **dict.fromkeys(LATENCY, AnswerLatency),
    "instruction": Instruction,
    "blind": Blind,
    "blank-instruction": BlankInstruction,
    "wrong-goal": WrongGoal,
    "variant-name": VariantName,
    "resampled": Resampled,
    "again": Unperturbed,
}
"""Axis to its wrapper. In a combination they wrap the simulation in this order: physics, what stands on the table,
cameras, the table's paint, light, lens, sensor, transport; then actions and instruction."""
_ORDER = list(_PERTURBED)


def perturbed(simulation: Simulation, episode: Episode, references: ReferenceImages | None = None) -> Simulation:
    """The simulation under the episode's condition: itself if clean, else in a wrapper per axis.

    Random draws depend on the pair alone, so two policies meet the same disturbance. In a combination each axis draws
    what it draws alone.

    Args:
        simulation: The clean simulation.
        episode: Its condition says what to change, and how much.
        references: Cached images of this simulation's task.

    Raises:
        UnsupportedCondition: There is no such axis or severity, or the axes do not combine.
    """
    try:
        axes = axes_of(episode.condition)
    except ValueError as error:
        raise UnsupportedCondition(str(error)) from None
    if not axes:
        return simulation
    if len(axes) > 1:
        references = None  # they are of the clean scene
    layers: list[Perturbed] = []
    for axis, severity in sorted(axes.items(), key=lambda item: _ORDER.index(item[0].name)):
        alone = replace(episode, condition=Condition.of(Perturbation(axis.name, severity)))
        layers.append(_PERTURBED[axis.name](layers[-1] if layers else simulation, axis, alone, references))
    if len(layers) == 1:
        return layers[0]
    for layer in layers:  # a moved camera or arm may hide the few distractors that there are
        layer.must_show &= not isinstance(layer, Distractors)
    return Combination(layers)
