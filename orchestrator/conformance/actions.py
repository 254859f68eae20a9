"""The action specification is true: every dimension does what it says, in metres and radians of the base frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.contract import ACTION_NAMES, FloatArray, Simulation
from orchestrator.conformance.findings import Check, Fault, check
from orchestrator.conformance.subject import Subject

LENGTH, ANGLE = 0.01, 0.03
"""Of a step in the checks (m, rad), where the simulation accepts as much."""
RUN_UP, MEASURED = 4, 5
"""Steps until the motion is steady, and steps that are measured then."""
TOLERANCE = 0.3
"""By which share the way may be longer or shorter."""
ASIDE, ASIDE_ANGLE = 0.2, 0.27
"""How much of the way may go along, or about, the other axes."""
DRAG = 0.08
"""How much an ignored rotation may turn the tool (rad), from carrying the arm along."""
OPEN_WIDTH, CLOSED_WIDTH = 0.04, 0.012
"""Sum of the finger positions of an open gripper at least, and of a closed one at most (m)."""
FACTORS = {
    -1.0: "the other sign",
    0.01: "a controller in centimetres",
    0.001: "a controller in millimetres",
    100.0: "actions taken for centimetres",
    np.pi / 180.0: "a controller in degrees",
    180.0 / np.pi: "actions taken for degrees",
}
"""Ways of the wrong length, as a factor, and what they may come from."""
GRIPPING = 15
"""Steps after which fingers have arrived."""


def _lifted(subject: Subject, back: FloatArray | None = None) -> Simulation:
    """At rest, a little above the start, away from table and things, and then some steps of `back` away."""
    simulation = subject.reset()
    height = min(0.02, simulation.action_spec.max_translation)
    for _ in range(3):
        simulation.step(subject.action(dz=height))
    if back is not None:
        for _ in range(RUN_UP + MEASURED):
            simulation.step(back.copy())
    for _ in range(6):
        simulation.step(subject.action())
    return simulation


def _position(simulation: Simulation) -> FloatArray:
    return np.array(simulation.privileged_state()["tcp_position"])


def _translation(name: str) -> Check:
    axis = ACTION_NAMES.index(name)

    @check(
        f"action-{name}", look="Simulation.step: scale, sign and frame (the robot's base) of what the controller gets"
    )
    def translation(subject: Subject) -> Iterator[Fault]:
        """In steady motion, a translation moves the tool by as many metres, along its axis of the base frame."""
        length = min(LENGTH, subject.simulation.action_spec.max_translation)
        way = MEASURED * length
        for sign in (1, -1):
            action = subject.action(**{name: sign * length})
            # A tool may start at the edge of where its controller lets it go: the way is gone back first, but not down.
            simulation = _lifted(
                subject, back=None if (name, sign) == ("dz", 1) else subject.action(**{name: -sign * length})
            )
            for _ in range(RUN_UP):
                simulation.step(action)
            start = _position(simulation)
            for _ in range(MEASURED):
                simulation.step(action)
            moved = sign * (_position(simulation) - start)
            aside = float(np.abs(np.delete(moved, axis)).max())
            if abs(moved[axis] - way) > TOLERANCE * way or aside > ASIDE * way:
                yield Fault(
                    f"{MEASURED} steps of {sign * length:+g} m in {name} to move the tool by {sign * way:+.3f} m",
                    "it moved by "
                    + ", ".join(f"{sign * m:+.3f} m in {a}" for m, a in zip(moved, "xyz", strict=True))
                    + hint(moved[axis] / way),
                )

    return translation


def hint(factor: float) -> str:
    """What a way that is too long or too short by a factor may be a sign of; nothing if the factor is none known."""
    for known, meaning in FACTORS.items():
        if abs(factor / known - 1.0) < TOLERANCE:
            return f" ({meaning}?)"
    return ""


def _rotation(name: str) -> Check:
    axis = ACTION_NAMES.index(name) - 3

    @check(
        f"action-{name}", look="Simulation.step: scale, sign and frame of the rotation (axis-angle, base frame, rad)"
    )
    def rotation(subject: Subject) -> Iterator[Fault]:
        """In steady motion, a rotation turns the tool by as many radians about its axis of the base frame."""
        spec = subject.simulation.action_spec
        ignored = subject.ignores(name)
        angle = ANGLE if ignored else min(ANGLE, spec.max_rotation)
        simulation = _lifted(subject)
        action = subject.action(**{name: angle})
        for _ in range(RUN_UP):
            simulation.step(action)
        start = _turn(simulation)
        for _ in range(MEASURED):
            simulation.step(action)
        turned = (_turn(simulation) * start.inv()).as_rotvec()
        seen = "it turned by " + ", ".join(f"{t:+.3f} rad about {a}" for t, a in zip(turned, "xyz", strict=True))
        way = MEASURED * angle
        seen += hint(turned[axis] / way)
        if ignored:
            if np.abs(turned).max() > DRAG:
                yield Fault(f"no turn from {name}, which is declared ignored", seen)
        elif abs(turned[axis] - way) > TOLERANCE * way or np.abs(np.delete(turned, axis)).max() > ASIDE_ANGLE * way:
            yield Fault(f"{MEASURED} steps of {angle:+g} rad in {name} to turn the tool by {way:+.3f} rad", seen)

    return rotation


def _turn(simulation: Simulation) -> Rotation:
    return Rotation.from_quat(simulation.privileged_state()["tcp_quaternion"])


@check("action-gripper", look="Simulation.step and finger_positions: -1 opens, +1 closes")
def gripper(subject: Subject) -> Iterator[Fault]:
    """The gripper opens at -1 and closes at +1, unless it is declared ignored."""
    widths = {}
    for command in (-1.0, 1.0):
        simulation = subject.reset()
        height = min(0.005, simulation.action_spec.max_translation)
        for _ in range(GRIPPING):
            simulation.step(subject.action(dz=height, gripper=command))
        widths[command] = float(np.abs(simulation.privileged_state()["finger_positions"]).sum())
    seen = f"{widths[-1.0]:.3f} m apart after {GRIPPING} steps at -1, {widths[1.0]:.3f} m at +1"
    if subject.ignores("gripper"):
        if abs(widths[1.0] - widths[-1.0]) > 1e-3:
            yield Fault("fingers that stay, since `gripper` is declared ignored", seen)
    elif not (widths[-1.0] > OPEN_WIDTH and widths[1.0] < CLOSED_WIDTH):
        yield Fault(f"fingers more than {OPEN_WIDTH:g} m apart at -1, less than {CLOSED_WIDTH:g} m at +1", seen)


@check("action-ignored", look="`ignored` of the ActionSpec, and what step does with these numbers")
def ignored(subject: Subject) -> Iterator[Fault]:
    """Dimensions that are declared ignored have no effect, each other dimension has one."""
    spec = subject.simulation.action_spec
    bounds = np.where(spec.high > 0.0, spec.high, ANGLE)
    moving = subject.action(dx=0.5 * spec.max_translation, gripper=0.5)
    moving[[ACTION_NAMES.index(name) for name in spec.ignored]] = 0.0
    usual = _end(subject, moving)
    for number, name in enumerate(ACTION_NAMES):
        differs = False
        for value in (-bounds[number], bounds[number]):
            other = moving.copy()
            other[number] = value
            differs = differs or _end(subject, other) != usual
        if differs and name in spec.ignored:
            yield Fault(f"no effect of {name}, which is declared ignored", "another state after 5 steps")
        elif not differs and name not in spec.ignored:
            yield Fault(f"an effect of {name}, or its name in `ignored`", "the same state after 5 steps")


@check("action-clipped", look="Simulation.step: clip to action_spec.low and .high")
def clipped(subject: Subject) -> Iterator[Fault]:
    """What is beyond the bounds is clipped to them."""
    spec = subject.simulation.action_spec
    signs = np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    signs[[ACTION_NAMES.index(name) for name in spec.ignored]] = 0.0
    at, beyond = _end(subject, signs * spec.high), _end(subject, 3.0 * signs * spec.high)
    if at != beyond:
        yield Fault("3 times the bounds to do what the bounds do", "another state after 5 steps")


@check("action-unchanged", look="Simulation.step: work on a copy of the action")
def unchanged(subject: Subject) -> Iterator[Fault]:
    """A step does not write to the action that it is given, nor keep it."""
    simulation = subject.reset()
    action = subject.random_actions(3, 1)[0]
    given = action.copy()
    simulation.step(given)
    if (given != action).any():
        yield Fault("the action as it was given", f"{np.round(given, 4).tolist()} after {np.round(action, 4).tolist()}")


def _end(subject: Subject, action: FloatArray) -> str:
    """State hash after 5 steps of an action."""
    simulation = subject.reset()
    for _ in range(5):
        simulation.step(action.copy())
    return simulation.state_hash()


CHECKS = (
    *(_translation(name) for name in ACTION_NAMES[:3]),
    *(_rotation(name) for name in ACTION_NAMES[3:6]),
    gripper,
    ignored,
    clipped,
    unchanged,
)
