"""The action specification is true, in metres and radians of the base frame, and the task can be solved."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import ACTION_NAMES, FloatArray, Simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.kit.adapter.check import Check, NotApplicable, Violation, check, expect
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask
from robogauntlet.policies.oracles import OraclePolicy, scripts
from robogauntlet.results.record import Status
from robogauntlet.suites.episode import Episode, Protocol

LENGTH, ANGLE = 0.01, 0.03
"""Translation (m) and rotation (rad) of a step in the checks, where the simulation accepts as much."""
RUN_UP, MEASURED = 4, 5
"""Steps until the motion is steady, and steps that are measured then."""
TOLERANCE = 0.3
"""Relative error of the distance along the axis that is accepted."""
SIDEWAYS, ASIDE_ANGLE = 0.2, 0.27
"""Share of the distance or angle that may go along, or about, the other axes."""
DRAG = 0.08
"""Angle by which an ignored rotation may turn the tool because it carries the arm along (rad)."""
OPEN_WIDTH, CLOSED_WIDTH = 0.04, 0.012
"""Smallest sum of the finger positions of an open gripper, and largest of a closed one (m)."""
FACTORS = {
    -1.0: "the other sign",
    0.01: "a controller in centimetres",
    0.001: "a controller in millimetres",
    100.0: "actions taken for centimetres",
    np.pi / 180.0: "a controller in degrees",
    180.0 / np.pi: "actions taken for degrees",
}
"""Factor of a wrong distance to its likely cause."""
TURN, TURNING = 0.1, 15
"""Change of a joint's target (rad), and steps until the arm is at rest."""
AT_A_VELOCITY = 5
"""Steps of a velocity that changes a target by as much."""
GRIPPING = 15
"""Steps after which the fingers have arrived."""
ORACLE_SEEDS = range(2)
ONE_WAY = 40
"""Steps of an action in one direction, after which the arm is at the end of its reach."""


def _lifted(subject: CheckedTask, arm: str, back: FloatArray | None = None) -> Simulation:
    """Bring an arm's tool to rest a little above the start, then execute some steps of `back`."""
    simulation = subject.reset()
    height = subject.length(0.02)
    for _ in range(3):
        simulation.step(subject.action(**{f"{arm}dz": height}))
    if back is not None:
        for _ in range(RUN_UP + MEASURED):
            simulation.step(back.copy())
    for _ in range(6):
        simulation.step(subject.action())
    return simulation


def _position(simulation: Simulation, arm: str) -> FloatArray:
    return np.array(simulation.privileged_state()[f"{arm}tcp_position"])


def _translation(name: str) -> Check:
    axis = ACTION_NAMES.index(name)

    @check(
        f"action-{name}",
        look="Simulation.step: scale, sign and frame (the robot's base) of the controller's input",
        of_joints=False,
    )
    def translation(subject: CheckedTask) -> Iterator[Violation]:
        """In steady motion, a translation moves the tool by as many metres, along its axis of the base frame."""
        length = subject.length(LENGTH)
        distance = MEASURED * length
        for arm, sign in itertools.product(subject.arms, (1, -1)):
            action = subject.action(**{arm + name: sign * length})
            # A tool may start at the edge of its controller's range, so it first moves the other way, but not down.
            back = None if (name, sign) == ("dz", 1) else subject.action(**{arm + name: -sign * length})
            simulation = _lifted(subject, arm, back)
            for _ in range(RUN_UP):
                simulation.step(action)
            start = _position(simulation, arm)
            for _ in range(MEASURED):
                simulation.step(action)
            moved = sign * (_position(simulation, arm) - start)
            sideways = float(np.abs(np.delete(moved, axis)).max())
            numbers = ", ".join(f"{sign * m:+.3f} m in {a}" for m, a in zip(moved, "xyz", strict=True))
            yield from expect(
                abs(moved[axis] - distance) <= TOLERANCE * distance and sideways <= SIDEWAYS * distance,
                f"{MEASURED} steps of {sign * length:+g} m in {arm}{name} to move the tool by {sign * distance:+.3f} m",
                f"it moved by {numbers}{hint(moved[axis] / distance)}",
            )

    return translation


def hint(factor: float) -> str:
    """The likely cause of a distance that is wrong by this factor; empty if none is known."""
    for known, meaning in FACTORS.items():
        if abs(factor / known - 1.0) < TOLERANCE:
            return f" ({meaning}?)"
    return ""


def _rotation(name: str) -> Check:
    axis = ACTION_NAMES.index(name) - 3

    @check(
        f"action-{name}",
        look="Simulation.step: scale, sign and frame of the rotation (axis-angle, base frame, rad)",
        of_joints=False,
    )
    def rotation(subject: CheckedTask) -> Iterator[Violation]:
        """In steady motion, a rotation turns the tool by as many radians about its axis of the base frame."""
        for arm in subject.arms:
            ignored = subject.ignores(arm + name)
            angle = ANGLE if ignored else min(ANGLE, subject.simulation.action_spec.max_rotation)
            simulation = _lifted(subject, arm)
            action = subject.action(**{arm + name: angle})
            for _ in range(RUN_UP):
                simulation.step(action)
            start = _orientation(simulation, arm)
            for _ in range(MEASURED):
                simulation.step(action)
            turned = (_orientation(simulation, arm) * start.inv()).as_rotvec()
            total = MEASURED * angle
            numbers = ", ".join(f"{t:+.3f} rad about {a}" for t, a in zip(turned, "xyz", strict=True))
            seen = f"it turned by {numbers}{hint(turned[axis] / total)}"
            if ignored:
                still = np.abs(turned).max() <= DRAG
                yield from expect(still, f"no turn from {arm}{name}, which is declared ignored", seen)
                continue
            about_others = np.abs(np.delete(turned, axis)).max()
            yield from expect(
                abs(turned[axis] - total) <= TOLERANCE * total and about_others <= ASIDE_ANGLE * total,
                f"{MEASURED} steps of {angle:+g} rad in {arm}{name} to turn the tool by {total:+.3f} rad",
                seen,
            )

    return rotation


def _orientation(simulation: Simulation, arm: str) -> Rotation:
    return Rotation.from_quat(simulation.privileged_state()[f"{arm}tcp_quaternion"])


@check(
    "action-joints",
    look="Simulation.step: order, sign and unit (rad, rad/s) of targets or velocities; and tcp_jacobian",
    of_joints=True,
)
def joints(subject: CheckedTask) -> Iterator[Violation]:
    """A joint turns by its target or velocity, in radians, the others stay, and the tool moves as the Jacobian says."""
    spec = subject.simulation.action_spec
    for (number, arm), (place, joint) in itertools.product(enumerate(subject.arms), enumerate(spec.joints)):
        name, index = arm + joint.name, spec.joints_of(number).start + place
        simulation = subject.reset()
        for _ in range(TURNING):
            simulation.step(subject.action())
        before = simulation.privileged_state()
        target = before[f"{arm}joint_targets"][place]
        turn = TURN if target + TURN <= joint.high else -TURN
        action = subject.action()
        action[index] += spec.per_radian * turn / (AT_A_VELOCITY if spec.velocities else 1)
        for step in range(TURNING):
            if spec.velocities and step == AT_A_VELOCITY:
                action = subject.action()
            simulation.step(action)
        after = simulation.privileged_state()
        turns = [after[f"{one}joint_angles"] - before[f"{one}joint_angles"] for one in subject.arms]
        turned, others = turns[number], np.abs(np.delete(np.concatenate(turns), len(spec.joints) * number + place))
        yield from expect(
            abs(turned[place] - turn) <= TOLERANCE * TURN and others.max(initial=0.0) <= SIDEWAYS * TURN,
            f"{name} to turn by {turn:+.2f} rad when its target does, and no other joint",
            f"it turned by {turned[place]:+.3f} rad{hint(turned[place] / turn)}, "
            f"another one by {others.max(initial=0.0):.3f}",
        )
        moved = after[f"{arm}tcp_position"] - before[f"{arm}tcp_position"]
        told = before[f"{arm}tcp_jacobian"][:3] @ turned
        yield from expect(
            np.linalg.norm(moved - told) <= TOLERANCE * max(float(np.linalg.norm(told)), LENGTH),
            f"the tool to move by {np.round(told, 3).tolist()} m with {name}, as tcp_jacobian says",
            f"it moved by {np.round(moved, 3).tolist()}",
        )
        target = after[f"{arm}joint_targets"][place]
        upwards = joint.high - target > target - joint.low
        action[index] = (2.0 if spec.velocities else 1.0) * (spec.high if upwards else spec.low)[index]
        simulation.step(action)
        stepped = abs(simulation.privileged_state()[f"{arm}joint_targets"][place] - target)
        most = min(joint.step, joint.high - target if upwards else target - joint.low)
        expected = f"the target of {name} to change by {most:g} rad, its `step` or what its range leaves"
        yield from expect(abs(stepped - most) <= 1e-3, expected, f"{stepped:.3f} rad")


@check("action-gripper", look="Simulation.step and finger_positions: -1 opens, +1 closes", of_robots=True)
def gripper(subject: CheckedTask) -> Iterator[Violation]:
    """The gripper opens at -1 and closes at +1, unless it is declared ignored."""
    for arm in subject.arms:
        widths = {}
        for command in (-1.0, 1.0):
            simulation = subject.reset()
            for _ in range(GRIPPING):
                simulation.step(subject.action(**{f"{arm}dz": subject.length(0.005), f"{arm}gripper": command}))
            widths[command] = float(np.abs(simulation.privileged_state()[f"{arm}finger_positions"]).sum())
        seen = f"{widths[-1.0]:.3f} m apart after {GRIPPING} steps at -1, {widths[1.0]:.3f} m at +1"
        if subject.ignores(f"{arm}gripper"):
            still = abs(widths[1.0] - widths[-1.0]) <= 1e-3
            yield from expect(still, f"fingers that stay, since `{arm}gripper` is declared ignored", seen)
            continue
        yield from expect(
            widths[-1.0] > OPEN_WIDTH and widths[1.0] < CLOSED_WIDTH,
            f"fingers more than {OPEN_WIDTH:g} m apart at -1 of {arm}gripper, less than {CLOSED_WIDTH:g} m at +1",
            seen,
        )


@check("action-ignored", look="`ignored` of the ActionSpec, and how step uses these numbers")
def ignored(subject: CheckedTask) -> Iterator[Violation]:
    """Dimensions that are declared ignored have no effect, each other dimension has one."""
    spec = subject.simulation.action_spec
    subject.reset()
    low, high = subject.bounds()
    if not spec.numbers:
        low, high = (np.where(bound != 0.0, bound, sign * ANGLE) for bound, sign in ((low, -1), (high, 1)))
    moving = subject.action(dx=0.5 * subject.length(0.02), gripper=0.5)
    moving[spec.ignored_indices] = 0.0
    usual = _end(subject, moving)
    for number, name in enumerate(spec.names):
        differs = False
        for value in (low[number], high[number]):
            other = moving.copy()
            other[number] = value
            differs = differs or _end(subject, other) != usual
        if differs and name in spec.ignored:
            yield Violation(f"no effect of {name}, which is declared ignored", "another state after 5 steps")
        elif not differs and name not in spec.ignored:
            yield Violation(f"an effect of {name}, or its name in `ignored`", "the same state after 5 steps")


@check("action-clipped", look="Simulation.step: clip to action_spec.low and .high")
def clipped(subject: CheckedTask) -> Iterator[Violation]:
    """An action beyond the bounds is clipped to them."""
    spec = subject.simulation.action_spec
    signs = np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0, 1.0] * spec.arms)
    if spec.joints or spec.numbers:
        signs = np.resize([1.0, -1.0], len(spec.high))
    signs[spec.ignored_indices] = 0.0
    low, high = subject.bounds()
    signs[~np.isfinite(spec.steps)] = 0.0
    bounds = np.where(signs < 0.0, -low, high) * signs
    steps = max((math.ceil((joint.high - joint.low) / joint.step) for joint in spec.joints), default=5)
    same = _end(subject, bounds, steps) == _end(subject, 3.0 * bounds, steps)
    yield from expect(same, "3 times the bounds to do what the bounds do", "another state after 5 steps")


@check("action-unchanged", look="Simulation.step: work on a copy of the action")
def unchanged(subject: CheckedTask) -> Iterator[Violation]:
    """A step does not write to the action that it is given."""
    simulation = subject.reset()
    action = subject.random_actions(3, 1)[0]
    given = action.copy()
    simulation.step(given)
    seen = f"{np.round(given, 4).tolist()} after {np.round(action, 4).tolist()}"
    yield from expect((given == action).all(), "the action as it was given", seen)


def _end(subject: CheckedTask, action: FloatArray, steps: int = 5) -> str:
    """State hash after some steps of an action."""
    simulation = subject.reset()
    for _ in range(steps):
        simulation.step(action.copy())
    return simulation.state_hash()


@check("start-is-no-success", look="the success predicate in Simulation.step")
def start_is_no_success(subject: CheckedTask) -> Iterator[Violation]:
    """The first step of an episode neither succeeds nor terminates."""
    for seed in ORACLE_SEEDS:
        outcome = subject.reset(seed).step(subject.action())
        running = not (outcome.success or outcome.terminated)
        yield from expect(running, f"no success at the first step of seed {seed}, and no end", outcome)


@check("ends", look="Simulation.step: the `terminated` and `truncated` of the environment that it steps", once=True)
def ends(subject: CheckedTask) -> Iterator[Violation]:
    """An episode ends where an environment of gymnasium, if the simulation steps one, ends it."""
    simulation = subject.reset()
    inner = next((value for value in vars(simulation).values() if isinstance(value, gymnasium.Env)), None)
    if inner is None:
        return
    step, said = inner.step, list[bool]()

    def watched(*args: Any, **kwargs: Any) -> Any:
        answer = step(*args, **kwargs)
        said.append(bool(answer[2] or answer[3]))
        return answer

    vars(inner)["step"] = watched
    try:
        horizon = subject.description.horizon
        for action, steps in _one_way_each(subject, horizon):
            simulation.reset(0)
            said.clear()
            for number in range(1, steps + 1):
                outcome = simulation.step(action)
                if not said:
                    return  # It is stepped in another way.
                if any(said) and not outcome.terminated:
                    expected = (
                        f"`terminated` at step {number} of {np.round(action, 3).tolist()}, as the environment says"
                    )
                    yield Violation(expected, str(outcome))
                    return
                if outcome.terminated:
                    break
    finally:
        del vars(inner)["step"]


def _one_way_each(subject: CheckedTask, horizon: int) -> Iterator[tuple[FloatArray, int]]:
    """Actions and steps that go one way: nowhere for the horizon, then up and down in each number for a while."""
    spec, still = subject.simulation.action_spec, subject.action()
    yield still, horizon
    for number, bounds in enumerate(zip(*subject.bounds(), strict=True)):
        for bound in () if spec.names[number] in spec.ignored else bounds:
            action = still.copy()
            action[number] = bound
            yield action, min(horizon, ONE_WAY)


@check(
    "oracle", look="the success predicate, the horizon of the TaskDescription, or the task's script (policies/oracles)"
)
def oracle(subject: CheckedTask) -> Iterator[Violation]:
    """The task's oracle succeeds within the horizon."""
    if subject.task not in scripts():
        raise NotApplicable(
            f"the task has no oracle; add one as the entry point '{subject.simulator.name}' of robogauntlet.oracles"
        )
    horizon = subject.description.horizon
    for seed in ORACLE_SEEDS:
        episode = Episode("oracle", "oracle", subject.task, seed, Protocol(horizon, 1, subject.view))
        row = rollout(subject.simulation, OraclePolicy(), episode)
        held = "held once, not for 5 steps in a row" if row.success_once else "never held"
        yield from expect(
            row.status == Status.SUCCESS,
            f"success of the oracle within {horizon} steps from seed {seed}",
            f"{row.status} after {row.steps} steps; the predicate {held}",
        )


CHECKS = (
    *(_translation(name) for name in ACTION_NAMES[:3]),
    *(_rotation(name) for name in ACTION_NAMES[3:6]),
    joints,
    gripper,
    ignored,
    clipped,
    unchanged,
    start_is_no_success,
    ends,
    oracle,
)
