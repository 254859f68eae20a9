"""What simulations let perturbations adjust in physics: set, read back, felt, and undone by a reset to the bit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Dynamics, Unreachable
from adapters.contract import FloatArray
from orchestrator.conformance.findings import Fault, NotApplicable, check
from orchestrator.conformance.subject import Subject, changed

SEED, SEED_IN_SIGHT = 3, 5
NO_THINGS = ("tcp_position", "goal_position")
"""Positions in the state that take no room."""
Part = TypeVar("Part")


def offered(subject: Subject, part: Part | None, name: str) -> Part:
    """An adjuster of the simulation.

    Raises:
        NotApplicable: It is not offered, with the card's reason if it has one.
    """
    if part is None:
        raise NotApplicable(subject.card.fixed.get(name, f"the adapter does not let its {name} be adjusted"))
    return part


@contextmanager
def restored(subject: Subject, faults: list[Fault], seed: int = SEED) -> Iterator[None]:
    """The start of an episode; finds out whether the next reset undoes what is done to it."""
    start = subject.start(seed)
    subject.reset(seed)
    yield
    subject.reset(seed)
    faults += [Fault("the next reset to undo it", seen) for seen in subject.differences(start)]


def play(subject: Subject, steps: int = 8) -> str:
    """A few steps that close the gripper, and the hash of what became of the world."""
    length = min(0.01, subject.simulation.action_spec.max_translation)
    for _ in range(steps):
        subject.simulation.step(subject.action(dx=length, dz=-length, gripper=1.0))
    return subject.simulation.state_hash()


@check("objects-box", look="`adjusters.objects.placeable`: the box that resets fill")
def objects_box(subject: Subject) -> Iterator[Fault]:
    """Things start within the box that is told, and fill it."""
    boxes = offered(subject, subject.adjusters.objects, "objects").placeable()
    states = [subject.reset(seed).privileged_state() for seed in range(12)]
    slid = np.array([state.get("settling_shift", np.zeros(1)) for state in states]) + 1e-6
    for name, box in boxes.items():
        found = np.array([state[f"{name}_position"][:2] for state in states])
        if (found < box.low - slid).any() or (found > box.high + slid).any():
            outside = f"from {_xy(found.min(axis=0))} to {_xy(found.max(axis=0))}"
            yield Fault(f"{name} between {_xy(box.low)} and {_xy(box.high)}", outside)
        elif not (np.ptp(found, axis=0) > 0.4 * (box.high - box.low)).all():
            filled = f"12 seeds spread over {_xy(np.ptp(found, axis=0))}"
            yield Fault(f"{name} to be put anywhere in a box of {_xy(box.high - box.low)}", filled)


@check("objects-move", look="`adjusters.objects.move`")
def objects_move(subject: Subject) -> Iterator[Fault]:
    """A thing is moved by the offset, is seen there, and stays at rest; nothing else moves."""
    objects, faults = offered(subject, subject.adjusters.objects, "objects"), list[Fault]()
    name = next(iter(objects.placeable()))
    with restored(subject, faults, SEED_IN_SIGHT):
        simulation = subject.simulation
        before, seen = simulation.privileged_state(), dict(simulation.observe().images)
        offset = _to_where_there_is_room(name, before)
        objects.move(name, offset)
        after = simulation.privileged_state()
        moved = after[f"{name}_position"] - before[f"{name}_position"]
        if not np.allclose(moved, [*offset, 0.0], atol=1e-5):
            yield Fault(f"{name} to move by {[*offset.tolist(), 0.0]} m", f"{np.round(moved, 4).tolist()}")
        if not np.allclose(after["tcp_position"], before["tcp_position"], atol=1e-9):
            yield Fault("the tool to stay where it was", "it moved too")
        images = simulation.observe().images
        if subject.simulator.renders and not any(changed(seen[camera], images[camera]) for camera in seen):
            yield Fault(f"{name} to be seen at its new place", "the same images")
        for _ in range(3):
            simulation.step(subject.action())
        drift = simulation.privileged_state()[f"{name}_position"] - after[f"{name}_position"]
        if not np.abs(drift[:2]).max() < 2e-3:
            yield Fault(f"{name} to stay at rest there", f"it drifts by {np.round(drift, 4).tolist()} m in 3 steps")
    yield from faults


def _to_where_there_is_room(name: str, state: Mapping[str, FloatArray]) -> FloatArray:
    """An offset (2,) of a thing, away from all others."""
    own = f"{name}_position"
    others = [place[:2] for key, place in state.items() if key.endswith("_position") and key not in (own, *NO_THINGS)]
    offsets = [np.array([x, y]) for x in (0.03, -0.03) for y in (-0.02, 0.02)]
    return max(
        offsets,
        key=lambda offset: min((np.linalg.norm(state[own][:2] + offset - place) for place in others), default=0.0),
    )


@check("arm-place", look="`adjusters.arm.place_tool`, and what the controller holds after it")
def arm_place(subject: Subject) -> Iterator[Fault]:
    """The tool is brought elsewhere, stays there, and nothing else moves."""
    arm, faults = offered(subject, subject.adjusters.arm, "arm"), list[Fault]()
    with restored(subject, faults):
        simulation = subject.simulation
        before = simulation.privileged_state()
        turn = Rotation.from_rotvec([0.1, -0.1, 0.2] if arm.turns else [0.0, 0.0, 0.0])
        position = before["tcp_position"] + np.array([0.03, 0.05, 0.03])
        orientation = turn * Rotation.from_quat(before["tcp_quaternion"])
        arm.place_tool(position, orientation.as_quat())
        after = simulation.privileged_state()
        missed = float(np.linalg.norm(after["tcp_position"] - position))
        twisted = float((Rotation.from_quat(after["tcp_quaternion"]) * orientation.inv()).magnitude())
        if not (missed < 1e-3 and twisted < 0.01):
            yield Fault(
                "the tool within 1 mm and 0.01 rad of the pose", f"{1000 * missed:.1f} mm, {twisted:.3f} rad off"
            )
        for name in set(before) - {"tcp_position", "tcp_quaternion"}:
            if not np.allclose(after[name], before[name], atol=1e-6):
                yield Fault(f"{name} to stay as it was", "it changed")
        if not np.allclose(simulation.observe().proprioception[:3], position, atol=1e-3):
            yield Fault("proprioception to tell of the new place", "another")
        still = subject.action(gripper=0.0) if subject.ignores("gripper") else subject.action()
        for _ in range(20):
            simulation.step(still)
        left = float(np.linalg.norm(simulation.privileged_state()["tcp_position"] - position))
        if not left < 0.01:
            yield Fault("the tool to be held there for 20 steps", f"{1000 * left:.0f} mm away")
    yield from faults


@check("arm-unreachable", look="`adjusters.arm.place_tool`: restore the arm before Unreachable is raised")
def arm_unreachable(subject: Subject) -> Iterator[Fault]:
    """A pose out of reach, or within the table, is refused and nothing changes."""
    arm, faults = offered(subject, subject.adjusters.arm, "arm"), list[Fault]()
    with restored(subject, faults):
        simulation = subject.simulation
        before, start = simulation.privileged_state(), simulation.state_hash()
        above = before.get("door_position", before["tcp_position"])
        places = {"2 m away": [2.0, 0.0, 0.5]}
        if subject.adjusters.stage is not None:
            places["in the table"] = [*above[:2], subject.adjusters.stage.table_height - 0.1]
        for where, position in places.items():
            try:
                arm.place_tool(np.array(position), before["tcp_quaternion"])
            except Unreachable:
                pass
            else:
                yield Fault(f"Unreachable for a pose {where}", "it was accepted")
            if simulation.state_hash() != start:
                yield Fault(f"the arm where it was after a pose {where}", "another state")
    yield from faults


@check("bodies", look="`adjusters.bodies`")
def bodies(subject: Subject) -> Iterator[Fault]:
    """Mass and friction are read back, leave the state as it is, and a reset gives the own ones back."""
    found, faults = offered(subject, subject.adjusters.bodies, "bodies"), list[Fault]()
    subject.reset(SEED)
    clean = play(subject)
    with restored(subject, faults):
        simulation = subject.simulation
        if found.dynamics() != Dynamics(1.0, 1.0):
            yield Fault("factors of 1 after a reset", str(found.dynamics()))
        start, asked = simulation.state_hash(), Dynamics(mass=2.0, friction=0.5)
        found.set_dynamics(asked)
        now = found.dynamics()
        if not np.allclose([now.mass, now.friction], [asked.mass, asked.friction], rtol=1e-5):
            yield Fault(str(asked), str(now))
        if simulation.state_hash() != start:
            yield Fault("the same state with other masses and frictions", "another")
        found.set_dynamics(Dynamics(mass=5.0, friction=0.3))
        play(subject)
    if found.dynamics() != Dynamics(1.0, 1.0):
        yield Fault("factors of 1 after a reset", str(found.dynamics()))
    if (again := play(subject)) != clean:
        yield Fault("the own mass and friction to act again after a reset", f"state hash {again} instead of {clean}")
    yield from faults


def _xy(values: FloatArray) -> str:
    return f"({values[0]:.3f}, {values[1]:.3f}) m"


CHECKS = (objects_box, objects_move, arm_place, arm_unreachable, bodies)
