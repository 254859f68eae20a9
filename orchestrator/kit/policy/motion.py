"""Findings about what a policy's numbers move: each alone in the simulation, and all together in an episode."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import ACTION_NAMES, VELOCITY, FloatArray, Moves, Simulation
from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.orchestrator.kit.policy.recording import Play

STEPS = 5
"""Control steps for which one number is applied alone."""
GRIPPER_STEPS = 15
TRANSLATIONS, ROTATIONS = ACTION_NAMES[:3], ACTION_NAMES[3:6]
HELD = 0.03
"""A target within this distance of where its joint starts holds it (rad); gravity bends an arm by as much."""
DIRECTIONS = (("forward", "backward"), ("left", "right"), ("up", "down"))
"""Positive and negative direction of x, y, z."""
TURNS = ("about x, the forward axis", "about y, the left axis", "about z, anticlockwise seen from above")


@dataclass(frozen=True)
class Movement:
    """What one number of the action does alone, at a given value, beyond what an arm does that holds its pose."""

    name: str
    value: float
    """Of a target, its change from where the joint starts (rad)."""
    translation: FloatArray
    """Of the tool, per step, or in all for a joint: (3,), m."""
    rotation: FloatArray
    """The same as an axis-angle vector in the base frame: (3,), rad."""


def movements(simulation: Simulation, plays: Sequence[Play]) -> Iterator[Movement]:
    """Apply the mean of each number but the gripper's alone, from the reset of the first play.

    A number whose mean is far below its size is applied with its root mean square. Targets of joints count from where
    they start, and change by no more than a joint follows in `STEPS` steps, within its range.
    """
    spec, seed = simulation.action_spec, plays[0].episode.seed
    values, holding = np.concatenate([play.offsets() for play in plays]), _holding(simulation, seed)
    least, low, high = 0.0, np.full(len(holding), -np.inf), np.full(len(holding), np.inf)
    if spec.body.moves is Moves.TARGETS:
        follows = STEPS * spec.steps
        least, low, high = HELD, np.maximum(-follows, spec.low - holding), np.minimum(follows, spec.high - holding)
    idle = _moved(simulation, holding, seed)
    for index, name in enumerate(spec.names[:-1]):
        if name in spec.ignored or np.abs(values[:, index]).max() <= least:
            continue
        value = float(np.clip(typical(values[:, index]), low[index], high[index]))
        action = holding.copy()
        action[index] += value
        moved = _moved(simulation, action, seed)
        turned = Rotation.from_rotvec(moved[1]) * Rotation.from_rotvec(idle[1]).inv()
        steps = 1 if spec.joints else STEPS
        yield Movement(name, value, (moved[0] - idle[0]) / steps, turned.as_rotvec() / steps)


def typical(values: FloatArray) -> float:
    """Return the mean, or the root mean square if the mean is less than a quarter of it."""
    mean, size = float(values.mean()), float(np.sqrt((values**2).mean()))
    return mean if abs(mean) >= size / 4 else size


def _holding(simulation: Simulation, seed: int) -> FloatArray:
    """The action that keeps the arm where the seed starts it."""
    if simulation.action_spec.body.moves is not Moves.TARGETS:
        return np.zeros(len(simulation.action_spec.names))
    simulation.reset(seed)
    state = simulation.privileged_state()
    return np.append(state["joint_targets"], state["gripper"])


def _moved(simulation: Simulation, action: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Translation (m) and rotation (rad) of the tool in `STEPS` steps."""
    action = np.clip(action, simulation.action_spec.low, simulation.action_spec.high)
    simulation.reset(seed)
    before = simulation.privileged_state()
    for _ in range(STEPS):
        if simulation.step(action).terminated:
            break
    after = simulation.privileged_state()
    turn = Rotation.from_quat(after["tcp_quaternion"]) * Rotation.from_quat(before["tcp_quaternion"]).inv()
    return after["tcp_position"] - before["tcp_position"], turn.as_rotvec()


def components(simulation: Simulation, actions: FloatArray, moves: Sequence[Movement]) -> Iterator[Finding]:
    """One finding for each number but the gripper's: its size, and what it moves."""
    found, spec = {move.name: move for move in moves}, simulation.action_spec
    for index, name in enumerate(spec.names[:-1]):
        values = actions[:, index]
        unit = "m" if name in TRANSLATIONS else "rad/s" if spec.velocities else "rad"
        numbers = {"mean": float(values.mean()), "lowest": float(values.min()), "highest": float(values.max())}
        size = f"{values.mean():+.3g} {unit} on average, {values.min():.3g} to {values.max():.3g}"
        if name in spec.ignored:
            text = "always 0; this task ignores it" if not values.any() else f"{size}; this task ignores it"
        elif name in found:
            text = f"{size}; {describe(found[name])}"
            numbers |= _effects(found[name])
        else:
            text = f"{size}; always near its start" if spec.body.moves is Moves.TARGETS else "always 0"
        yield Finding(name, Level.NOTE, text, numbers)


def _effects(move: Movement) -> dict[str, float]:
    suffix = "_per_step" if move.name in ACTION_NAMES else ""
    effects = {} if move.name in ROTATIONS else {"m": move.translation}
    effects |= {} if move.name in TRANSLATIONS else {"rad": move.rotation}
    return {
        f"{axis}_{unit}{suffix}": float(value)
        for unit, effect in effects.items()
        for axis, value in zip("xyz", effect, strict=True)
    }


def describe(move: Movement) -> str:
    """Say which way the tool goes, such as `+0.01 alone moves the tool forward (+x), 0.8 cm per step`.

    A joint may also turn it: `+0.4 rad alone moves the tool left (+y), 9 cm, and turns it +23 degrees about z, ...`.
    """
    if move.name in TRANSLATIONS:
        return f"{move.value:+.3g} alone {_shift(move.translation, 1e-5, ' per step') or 'does not move the tool'}"
    if move.name in ROTATIONS:
        turned = _turn(move.rotation, 1e-4, " per step")
        return f"{move.value:+.3g} alone {f'turns the tool {turned}' if turned else 'does not turn the tool'}"
    shifted, turned = _shift(move.translation, 1e-3, ""), _turn(move.rotation, 0.01, "")
    parts = [shifted, turned and f"turns {'it' if shifted else 'the tool'} {turned}"]
    unit = f"rad/s for {STEPS} steps" if move.name.endswith(VELOCITY) else "rad"
    return f"{move.value:+.3g} {unit} alone {', and '.join(filter(None, parts)) or 'hardly moves the tool'}"


def _shift(translation: FloatArray, least: float, per: str) -> str:
    axis = int(np.abs(translation).argmax())
    amount = float(translation[axis])
    way = f"{_direction(axis, amount)} ({'+' if amount > 0 else '-'}{'xyz'[axis]})"
    return f"moves the tool {way}, {100 * abs(amount):.2g} cm{per}" if abs(amount) >= least else ""


def _direction(axis: int, amount: float) -> str:
    positive, negative = DIRECTIONS[axis]
    return negative if amount < 0 else positive


def _turn(rotation: FloatArray, least: float, per: str) -> str:
    axis = int(np.abs(rotation).argmax())
    amount = float(rotation[axis])
    return f"{np.degrees(amount):+.2g} degrees{per} {TURNS[axis]}" if abs(amount) >= least else ""


def fingers(simulation: Simulation, seed: int) -> Iterator[Finding]:
    """How far the fingers are apart after open and closed commands."""
    if "gripper" in simulation.action_spec.ignored:
        return
    gaps, action = [], _holding(simulation, seed)
    for command in (-1.0, 1.0):
        simulation.reset(seed)
        action[-1] = command
        for _ in range(GRIPPER_STEPS):
            if simulation.step(action).terminated:
                break
        gaps.append(float(np.abs(simulation.privileged_state()["finger_positions"]).sum()))
    text = f"-1 leaves the fingers {100 * gaps[0]:.1f} cm apart, +1 leaves them {100 * gaps[1]:.1f} cm apart"
    yield Finding("fingers", Level.NOTE, text, {"open_m": gaps[0], "closed_m": gaps[1]})


def whole(played: Play) -> Iterator[Finding]:
    """Where the tool went in an episode, and what it came closer to."""
    way = played.tool[-1] - played.tool[0]
    parts = [
        f"{100 * abs(amount):.1f} cm {_direction(axis, amount)}"
        for axis, amount in enumerate(way)
        if abs(amount) >= 1e-3
    ]
    steps = len(played.tool) - 1
    text = f"in {steps} steps the tool moved {', '.join(parts) or 'less than 1 mm'}{'; success' * played.success}"
    yield Finding("path", Level.NOTE, text, dict(zip(("x_m", "y_m", "z_m"), way.tolist(), strict=True)))
    if not played.distances:
        return
    changes = [
        f"{name} {100 * values[0]:.0f} to {100 * values.min():.0f} cm at the closest"
        for name, values in played.distances.items()
    ]
    closer = any(values.min() < values[0] - 0.01 for values in played.distances.values())
    text = f"distance of the tool: {', '.join(changes)}"
    if not closer:
        text += "; it approaches no object: wrong frame or signs, or another task than it was trained on?"
    numbers = {f"{name}_closest_m": float(values.min()) for name, values in played.distances.items()}
    yield Finding("approach", Level.OK if closer else Level.WARNING, text, numbers)
