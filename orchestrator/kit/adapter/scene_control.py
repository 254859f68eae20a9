"""Scene controls that act on physics: set, read back, effective, and undone exactly by a reset."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray, is_of_second_arm
from robogauntlet.adapters.frames import proprioception
from robogauntlet.adapters.scene_control import Arm, BodyDynamics, DynamicsFactors, Objects, Unreachable
from robogauntlet.orchestrator.kit.adapter.check import Check, NotApplicable, Violation, check, expect, expect_restored
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask, most_changed

SEED, SEED_IN_SIGHT = 3, 5
NO_OBSTACLES = ("tcp_position", "goal_position")
"""Positions in the state that are no obstacles, beside those of a second arm."""


def offered(subject: CheckedTask, part: str) -> Any:
    """Return a control of the simulation, by its name in `SceneControls`.

    Raises:
        NotApplicable: The simulation has no such control, with the reason that the task's description gives.
    """
    control = getattr(subject.scene_controls, part)
    if control is None:
        raise NotApplicable(subject.description.fixed.get(part, f"the adapter does not let its {part} be adjusted"))
    return control


def control_check(
    name: str, part: str, *, look: str, seed: int = SEED, renders: bool = False
) -> Callable[[Callable[[CheckedTask, Any], Iterator[Violation]]], Check]:
    """Turn a function that uses a control at the start of an episode into a check; the next reset must undo it."""

    def decorate(body: Callable[[CheckedTask, Any], Iterator[Violation]]) -> Check:
        @wraps(body)
        def restored(subject: CheckedTask) -> Iterator[Violation]:
            control = offered(subject, part)
            start = subject.start(seed)
            subject.reset(seed)
            yield from body(subject, control)
            yield from expect_restored(subject, start, "the next reset to undo it")

        return check(name, look=look, renders=renders)(restored)

    return decorate


def play(subject: CheckedTask, steps: int = 8) -> str:
    """Execute a few steps that close the gripper, and return the state hash after them."""
    length = subject.length(0.01)
    for _ in range(steps):
        subject.simulation.step(subject.action(dx=length, dz=-length, gripper=1.0))
    return subject.simulation.state_hash()


@check("objects-box", look="`scene_controls.objects.placeable`: the box that resets fill")
def objects_box(subject: CheckedTask) -> Iterator[Violation]:
    """Objects start within the declared box, and fill it."""
    boxes = offered(subject, "objects").placeable()
    states = [subject.reset(seed).privileged_state() for seed in range(12)]
    slid = np.array([state.get("settling_shift", np.zeros(1)) for state in states]) + 1e-6
    for name, box in boxes.items():
        positions = np.array([state[f"{name}_position"][:2] for state in states])
        spread = np.ptp(positions, axis=0)
        if (positions < box.low - slid).any() or (positions > box.high + slid).any():
            outside = f"from {_xy(positions.min(axis=0))} to {_xy(positions.max(axis=0))}"
            yield Violation(f"{name} between {_xy(box.low)} and {_xy(box.high)}", outside)
        elif not (spread > 0.4 * (box.high - box.low)).all():
            expected = f"{name} to be put anywhere in a box of {_xy(box.high - box.low)}"
            yield Violation(expected, f"12 seeds spread over {_xy(spread)}")


@control_check("objects-move", "objects", seed=SEED_IN_SIGHT, look="`scene_controls.objects.move`")
def objects_move(subject: CheckedTask, objects: Objects) -> Iterator[Violation]:
    """An object is moved by the offset, is seen there, and stays at rest; nothing else moves."""
    name = next(iter(objects.placeable()))
    simulation = subject.simulation
    before, images = simulation.privileged_state(), dict(simulation.observe().images)
    offset = _free_offset(name, before)
    objects.move(name, offset)
    after = simulation.privileged_state()
    moved = after[f"{name}_position"] - before[f"{name}_position"]
    expected = f"{name} to move by {[*offset.tolist(), 0.0]} m"
    yield from expect(np.allclose(moved, [*offset, 0.0], atol=1e-5), expected, np.round(moved, 4).tolist())
    same_tool = np.allclose(after["tcp_position"], before["tcp_position"], atol=1e-9)
    yield from expect(same_tool, "the tool to stay where it was", "it moved too")
    seen = not subject.simulator.renders or most_changed(images, simulation.observe().images) > 0.0
    yield from expect(seen, f"{name} to be seen at its new place", "the same images")
    for _ in range(3):
        simulation.step(subject.action())
    drift = simulation.privileged_state()[f"{name}_position"] - after[f"{name}_position"]
    at_rest = np.abs(drift[:2]).max() < 2e-3
    seen_drift = f"it drifts by {np.round(drift, 4).tolist()} m in 3 steps"
    yield from expect(at_rest, f"{name} to stay at rest there", seen_drift)


def _free_offset(name: str, state: Mapping[str, FloatArray]) -> FloatArray:
    """Return an offset (2,) of an object, away from all others."""
    own = f"{name}_position"
    others = [
        place[:2]
        for key, place in state.items()
        if key.endswith("_position") and not is_of_second_arm(key) and key not in (own, *NO_OBSTACLES)
    ]
    offsets = [np.array([x, y]) for x in (0.03, -0.03) for y in (-0.02, 0.02)]
    return max(
        offsets,
        key=lambda offset: min((np.linalg.norm(state[own][:2] + offset - place) for place in others), default=0.0),
    )


@control_check("arm-place", "arm", look="`scene_controls.arm.place_tool`, and the pose that the controller then holds")
def arm_place(subject: CheckedTask, arm: Arm) -> Iterator[Violation]:
    """The tool is brought to another pose, stays there, and nothing else moves."""
    simulation = subject.simulation
    before = simulation.privileged_state()
    turn = Rotation.from_rotvec([0.1, -0.1, 0.2])
    position = before["tcp_position"] + np.array([0.03, 0.05, 0.03])
    orientation = turn * Rotation.from_quat(before["tcp_quaternion"])
    arm.place_tool(position, orientation.as_quat())
    after = simulation.privileged_state()
    missed = float(np.linalg.norm(after["tcp_position"] - position))
    angle = float((Rotation.from_quat(after["tcp_quaternion"]) * orientation.inv()).magnitude())
    expected = "the tool within 1 mm and 0.01 rad of the pose"
    yield from expect(missed < 1e-3 and angle < 0.01, expected, f"{1000 * missed:.1f} mm, {angle:.3f} rad off")
    of_joints = bool(simulation.action_spec.joints)
    own = {"tcp_position", "tcp_quaternion"} | (
        {"joint_angles", "joint_targets", "tcp_jacobian"} if of_joints else set()
    )
    for name in set(before) - own:
        yield from expect(np.allclose(after[name], before[name], atol=1e-6), f"{name} to stay as it was", "it changed")
    read = np.allclose(simulation.observe().proprioception, proprioception(after, of_joints=of_joints), atol=1e-3)
    yield from expect(read, "proprioception to show the new pose", "another")
    still = subject.action(gripper=0.0) if subject.ignores("gripper") else subject.action()
    for _ in range(20):
        simulation.step(still)
    left = float(np.linalg.norm(simulation.privileged_state()["tcp_position"] - position))
    yield from expect(left < 0.01, "the tool to be held there for 20 steps", f"{1000 * left:.0f} mm away")


@control_check(
    "arm-unreachable", "arm", look="`scene_controls.arm.place_tool`: restore the arm before Unreachable is raised"
)
def arm_unreachable(subject: CheckedTask, arm: Arm) -> Iterator[Violation]:
    """A pose out of reach, or within the table, is refused and nothing changes."""
    simulation, controls = subject.simulation, subject.scene_controls
    before, start = simulation.privileged_state(), simulation.state_hash()
    objects = controls.objects.placeable() if controls.objects else {}
    above = before[f"{next(iter(objects))}_position" if objects else "tcp_position"]
    poses = {"2 m away": [2.0, 0.0, 0.5]}
    if controls.table is not None:
        poses["in the table"] = [*above[:2], controls.table.table_height - 0.1]
    for where, position in poses.items():
        try:
            arm.place_tool(np.array(position), before["tcp_quaternion"])
        except Unreachable:
            pass
        else:
            yield Violation(f"Unreachable for a pose {where}", "it was accepted")
        same = simulation.state_hash() == start
        yield from expect(same, f"the arm where it was after a pose {where}", "another state")


@control_check("dynamics", "dynamics", look="`scene_controls.dynamics`")
def dynamics(subject: CheckedTask, control: BodyDynamics) -> Iterator[Violation]:
    """Mass and friction are read back, leave the state as it is, and a reset restores the task's own."""
    clean = play(subject)
    simulation = subject.reset(SEED)
    yield from _expect_factors_of_one(control)
    start, asked = simulation.state_hash(), DynamicsFactors(mass=2.0, friction=0.5)
    control.set_dynamics(asked)
    now = control.dynamics()
    same = np.allclose([now.mass, now.friction], [asked.mass, asked.friction], rtol=1e-5)
    yield from expect(same, str(asked), now)
    same = simulation.state_hash() == start
    yield from expect(same, "the same state with other masses and frictions", "another")
    control.set_dynamics(DynamicsFactors(mass=5.0, friction=0.3))
    play(subject)
    subject.reset(SEED)
    yield from _expect_factors_of_one(control)
    again = play(subject)
    expected = "the own mass and friction to act again after a reset"
    yield from expect(again == clean, expected, f"state hash {again} instead of {clean}")


def _expect_factors_of_one(control: BodyDynamics) -> Iterator[Violation]:
    factors = control.dynamics()
    yield from expect(factors == DynamicsFactors(1.0, 1.0), "factors of 1 after a reset", factors)


def _xy(values: FloatArray) -> str:
    return f"({values[0]:.3f}, {values[1]:.3f}) m"


CHECKS = (objects_box, objects_move, arm_place, arm_unreachable, dynamics)
