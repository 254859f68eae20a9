"""Types, shapes and units of everything that an adapter declares and returns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set

import numpy as np

from robogauntlet.adapters.contract import (
    PICTURE_SIZE,
    ActionSpec,
    FloatArray,
    Joint,
    Observation,
    ObservationSpec,
    StepOutcome,
    names_of_arms,
)
from robogauntlet.adapters.frames import axis_angle
from robogauntlet.adapters.scene_control import ADJUSTABLE
from robogauntlet.orchestrator.kit.adapter.check import Violation, check, expect
from robogauntlet.orchestrator.kit.adapter.checked_task import CannotOpen, CheckedTask, describe
from robogauntlet.suites.episode import CAMERAS

BENT = 0.1
"""Angle by which a joint may be beyond its limits (rad)."""
FARTHEST = 2.0
"""Largest distance of a tool from the base of an arm on a table (m)."""
WIDEST = 0.2
"""Largest distance of a finger from the middle (m)."""
FLAT = 5.0
"""Standard deviation of the pixels below which an image shows nothing."""
MOST_TURNED = 7.0
"""Largest angle of a joint (rad)."""
OF_JOINTS = {"max_translation": (0.0, 0.0, "m"), "max_rotation": (0.0, 0.0, "rad"), "control_hz": (1.0, 1000.0, "1/s")}
"""The same as `PER_STEP`, where no tool is moved."""
PER_STEP = {"max_translation": (1e-4, 0.2, "m"), "max_rotation": (0.0, 1.0, "rad"), "control_hz": (1.0, 1000.0, "1/s")}
"""Plausible values for one control step: least, greatest, unit."""
HEAVY = ("torch", "mujoco", "sapien", "pybullet", "gymnasium", "jax", "tensorflow", "cv2")


@check("declaration", look="the imports at the top of the adapter: the simulator is imported by `open` only", once=True)
def declaration(subject: CheckedTask) -> Iterator[Violation]:
    """Declaring the simulator imports neither it nor anything heavy."""
    unwanted = {*subject.simulator.modules, *HEAVY} & subject.loaded_by_declaring
    yield from expect(not unwanted, "an entry point that imports no simulator", f"it imports {_listed(unwanted)}")


@check("description", look="the Simulator that the entry point declares, and its TaskDescriptions")
def description(subject: CheckedTask) -> Iterator[Violation]:
    """The declaration is complete: instruction, horizon, scene controls and reasons."""
    simulator, task = subject.simulator, subject.description
    one_line = task.instruction.strip() and task.instruction == " ".join(task.instruction.split())
    yield from expect(one_line, "an instruction in words, on one line", repr(task.instruction))
    positive = type(task.horizon) is int and task.horizon >= 1
    yield from expect(positive, "a horizon of 1 control step or more", repr(task.horizon))
    unknown = simulator.adjusts - ADJUSTABLE
    yield from expect(not unknown, f"`adjusts` out of {_listed(ADJUSTABLE)}", _listed(unknown))
    stray = task.fixed.keys() - simulator.adjusts
    yield from expect(not stray, "`fixed` to name what the simulator adjusts in other tasks", _listed(stray))
    mute = {name for name, reason in task.fixed.items() if not reason.strip()}
    yield from expect(not mute, "a reason for all that is `fixed`", f"none for {_listed(mute)}")
    known = set(task.cameras) <= set(CAMERAS) and CAMERAS[0] in task.cameras
    expected = f"`cameras` out of {', '.join(CAMERAS)}, {CAMERAS[0]} among them"
    yield from expect(known, expected, ", ".join(task.cameras) or "none")


@check("opens", look="Simulator.open, and reset")
def opens(subject: CheckedTask) -> Iterator[Violation]:
    """The task opens and is reset without an error."""
    try:
        _ = subject.simulation
    except CannotOpen as error:
        yield Violation("the task to open", describe(error.__cause__ or error))


@check("adjusts", look="`scene_controls` of the simulation, `adjusts` of the Simulator, `fixed` of the TaskDescription")
def adjusts(subject: CheckedTask) -> Iterator[Violation]:
    """The scene controls are those that are declared, except what is fixed in this task."""
    offered = subject.scene_controls.offered()
    declared = subject.simulator.adjusts - subject.description.fixed.keys()
    yield from expect(offered == declared, _listed(declared), f"{_listed(offered)} offered by the simulation")


@check("specs", look="action_spec and observation_spec")
def specs(subject: CheckedTask) -> Iterator[Violation]:
    """Specifications are in metres, radians and hertz, and match the view."""
    action, observed = subject.simulation.action_spec, subject.simulation.observation_spec
    if not isinstance(action, ActionSpec) or not isinstance(observed, ObservationSpec):
        seen = f"{type(action).__name__}, {type(observed).__name__}"
        yield Violation("an ActionSpec and an ObservationSpec", seen)
        return
    plausible = OF_JOINTS if action.joints or action.numbers else PER_STEP
    for name, (low, high, unit) in plausible.items():
        value = getattr(action, name)
        yield from expect(low <= value <= high, f"{name} of {low:g} to {high:g} {unit}", f"{value:g}")
    for joint in action.joints:
        known = -MOST_TURNED <= joint.low < joint.high <= MOST_TURNED
        known &= 0.0 < joint.step <= 1.0 or joint.step == joint.high - joint.low
        sought = f"{joint.name} from low to high, within {MOST_TURNED:g} rad, and a step of at most 1 rad, or all of it"
        yield from expect(known, sought, f"{joint.low:g} to {joint.high:g}, step {joint.step:g}")
    for number in action.numbers:
        expected = f"{number.name} with low below high"
        yield from expect(number.low < number.high, expected, f"{number.low:g} to {number.high:g}")
    described = subject.description
    pairs = {"numbers": (action.body.native, described.native), "state": (action.state, described.state)}
    for what, (own, wanted) in pairs.items():
        expected = f"{what} {', '.join(wanted) or 'none'}, as the TaskDescription says"
        yield from expect(own == wanted, expected, ", ".join(own) or "none")
    arms, joints = subject.description.arms, subject.description.joints
    yield from expect(action.arms == arms, f"{arms} as `arms`, as the TaskDescription says", f"{action.arms}")
    same = action.body.joints == joints
    yield from expect(same, f"joints {', '.join(joints)}, as the TaskDescription says", ", ".join(action.body.joints))
    moves = subject.description.body.moves
    same = not same or action.body.moves == moves
    yield from expect(same, f"{moves}, as the TaskDescription says", action.body.moves)
    unknown = set(action.ignored) - set(action.names)
    yield from expect(not unknown, f"`ignored` out of {', '.join(action.names)}", _listed(unknown))
    rotations = {name for name in action.names if name.endswith(("rx", "ry", "rz")) and not action.numbers}
    declared = action.max_rotation != 0.0 or rotations <= set(action.ignored)
    expected = "rotations declared in `ignored` where max_rotation is 0"
    yield from expect(declared, expected, f"ignored: {action.ignored}")
    asked = ObservationSpec(subject.view.cameras, subject.view.image_size)
    same = (tuple(observed.cameras), observed.image_size) == (asked.cameras, asked.image_size)
    yield from expect(same, f"the cameras and the size that were asked for, {asked}", observed)


@check("observation", look="Simulation.observe")
def observation(subject: CheckedTask) -> Iterator[Violation]:
    """An observation has the images that were asked for, proprioception and the instruction."""
    seen = subject.reset().observe()
    if not isinstance(seen, Observation):
        yield Violation("an Observation", type(seen).__name__)
        return
    cameras, size = subject.view.cameras, subject.view.image_size
    spec = subject.simulation.action_spec
    numbers = spec.body.proprioception_dim
    same = seen.of_joints == bool(spec.joints)
    yield from expect(same, f"`of_joints` {bool(spec.joints)}, as the ActionSpec says", seen.of_joints)
    native = len(spec.numbers) or None
    yield from expect(seen.native == native, f"`native` {native}, as the ActionSpec says", seen.native)
    expected = f"images of {', '.join(cameras)}, in this order"
    yield from expect(tuple(seen.images) == cameras, expected, ", ".join(seen.images) or "none")
    for camera, image in seen.images.items():
        yield from _array(f"the image of {camera}", image, (size, size, 3), np.dtype(np.uint8))
    yield from _array("proprioception", seen.proprioception, (numbers,), np.dtype(np.float64))
    instruction = subject.description.instruction
    same = seen.instruction == instruction or (subject.description.own_words and bool(seen.instruction))
    yield from expect(same, f"the task's instruction, '{instruction}'", repr(seen.instruction))


@check("images", look="Simulation.observe and the poses of the cameras", renders=True)
def images(subject: CheckedTask) -> Iterator[Violation]:
    """Every camera shows something."""
    for camera, image in subject.reset().observe().images.items():
        contrast = float(np.std(image))
        expected = f"{camera} to show something, pixels that deviate by {FLAT:g} of 255 or more"
        yield from expect(contrast >= FLAT, expected, f"{contrast:.1f}")


@check(
    "units", look="the base frame and the units of privileged_state and proprioception: metres, radians", of_robots=True
)
def units(subject: CheckedTask) -> Iterator[Violation]:
    """The tool starts in front of the base, pointing down, in metres and radians."""
    simulation = subject.reset()
    state, seen = simulation.privileged_state(), simulation.observe().proprioception
    for arm, own in zip(subject.arms, np.split(seen, len(subject.arms)), strict=True):
        part = f"{arm}proprioception"
        positions = [(f"{arm}tcp_position", state[f"{arm}tcp_position"]), (f"{part}[:3]", own[:3])]
        if joints := simulation.action_spec.joints:
            positions.pop()
        for name, position in positions:
            if not np.abs(position).max() < FARTHEST:
                yield Violation(f"{name} within {FARTHEST:g} m of the base", _numbers(position))
            elif not (position[0] > 0.1 and abs(position[1]) < position[0]):
                yield Violation(f"{name} in front of the base: x forward, y left", f"{_numbers(position)} m")
        if joints:
            yield from _joint_units(joints, part, own)
            continue
        turn = float(np.linalg.norm(own[3:6]))
        expected = f"{part}[3:6] near (pi, 0, 0) rad, pointing down"
        yield from expect(abs(turn - np.pi) < 0.35, expected, f"{_numbers(own[3:6])}: {turn:.2f} long")
        for name, fingers in ((f"{arm}finger_positions", state[f"{arm}finger_positions"]), (f"{part}[6:]", own[6:])):
            near = np.abs(fingers).max() < WIDEST
            yield from expect(near, f"{name} within {WIDEST:g} m of the middle", _numbers(fingers))


def _joint_units(joints: Sequence[Joint], part: str, own: FloatArray) -> Iterator[Violation]:
    """Joints are within their limits, and the gripper within its scale, at the start."""
    for joint, angle in zip(joints, own[:-1], strict=True):
        expected = f"{joint.name} of {part} from {joint.low:g} to {joint.high:g} rad"
        yield from expect(joint.low - BENT <= angle <= joint.high + BENT, expected, f"{angle:.3f}")
    yield from expect(abs(own[-1]) <= 1.1, f"the gripper of {part} from -1 (open) to +1 (closed)", f"{own[-1]:.3f}")


@check("privileged-state", look="Simulation.privileged_state")
def privileged_state(subject: CheckedTask) -> Iterator[Violation]:
    """The privileged state has tool, fingers and objects, or what is native, as finite float64 arrays."""
    state = subject.reset().privileged_state()
    if not isinstance(state, Mapping):
        yield Violation("a mapping of names to arrays", type(state).__name__)
        return
    expected_names = names_of_arms(("tcp_position", "tcp_quaternion", "finger_positions"), len(subject.arms))
    of_second = ("second_base_position", "second_base_quaternion") if len(subject.arms) == 2 else ()
    spec = subject.simulation.action_spec
    width = len(spec.joints)
    if spec.numbers:
        expected_names = ("state", "still")
        yield from _array("state", state.get("state"), (len(spec.state),), np.dtype(np.float64))
        yield from _array("still", state.get("still"), (len(spec.numbers),), np.dtype(np.float64))
    one = {"joint_angles": (width,), "joint_targets": (width,), "gripper": (1,), "tcp_jacobian": (6, width)}
    of_joints = {f"{arm}{name}": shape for arm in subject.arms for name, shape in one.items()}
    for name in (*expected_names, *of_second, *(of_joints if width else ())):
        yield from expect(name in state, f"`{name}`", _listed(state.keys()))
    shapes: dict[str, tuple[int, ...]] = {"_position": (3,), "_positions": (2,), "_quaternion": (4,)}
    for name, value in state.items():
        shape = next((shape for end, shape in shapes.items() if name.endswith(end)), None)
        if width:
            shape = of_joints.get(name, shape)
        yield from _array(name, value, shape, np.dtype(np.float64))
        if name.endswith("_quaternion") and np.shape(value) == (4,):
            length = float(np.linalg.norm(value))
            seen = f"{_numbers(value)}: {length:.3f} long"
            yield from expect(abs(length - 1.0) <= 1e-4, f"{name} of length 1, xyzw", seen)


@check("proprioception", look="proprioception in Simulation.observe, and privileged_state")
def proprioception(subject: CheckedTask) -> Iterator[Violation]:
    """Proprioception agrees with the privileged state."""
    simulation = subject.reset(1)
    for action in subject.random_actions(5, 6):
        simulation.step(action)
    seen, state = simulation.observe().proprioception, simulation.privileged_state()
    if simulation.action_spec.numbers:
        same = np.allclose(seen, state["state"], atol=1e-6, rtol=0.0)
        yield from expect(same, f"state: {_numbers(state['state'])}", _numbers(seen))
        return
    for arm, own in zip(subject.arms, np.split(seen, len(subject.arms)), strict=True):
        if subject.simulation.action_spec.joints:
            true = np.append(state[f"{arm}joint_angles"], state[f"{arm}gripper"])
            same = np.allclose(own, true, atol=1e-6, rtol=0.0)
            yield from expect(same, f"{arm}joint_angles and gripper: {_numbers(true)}", _numbers(own))
            continue
        turn = axis_angle(state[f"{arm}tcp_quaternion"])
        parts = {
            f"position, {arm}tcp_position": (own[:3], state[f"{arm}tcp_position"], 1e-6),
            f"axis-angle, axis_angle({arm}tcp_quaternion)": (own[3:6], turn, 1e-5),
            f"fingers, {arm}finger_positions": (own[6:], state[f"{arm}finger_positions"], 1e-6),
        }
        for name, (given, true, tolerance) in parts.items():
            same = np.allclose(given, true, atol=tolerance, rtol=0.0)
            yield from expect(same, f"{name}: {_numbers(true)}", _numbers(given))


@check("step-outcome", look="Simulation.step")
def step_outcome(subject: CheckedTask) -> Iterator[Violation]:
    """A step returns a finite reward, success and terminated, as plain Python types."""
    outcome = subject.reset().step(subject.action())
    if not isinstance(outcome, StepOutcome):
        yield Violation("a StepOutcome", type(outcome).__name__)
        return
    finite = isinstance(outcome.reward, float) and np.isfinite(outcome.reward)
    yield from expect(finite, "a finite float as reward", f"{outcome.reward!r}, {type(outcome.reward).__name__}")
    for name, value in (("success", outcome.success), ("terminated", outcome.terminated)):
        yield from expect(type(value) is bool, f"a bool as {name}", f"{value!r}, {type(value).__name__}")


@check("state-hash", look="Simulation.state_hash")
def state_hash(subject: CheckedTask) -> Iterator[Violation]:
    """The state hash is text, and changes with the state."""
    simulation = subject.reset()
    before = simulation.state_hash()
    yield from expect(isinstance(before, str) and before, "text", repr(before))
    again = simulation.state_hash()
    yield from expect(again == before, "the same hash while nothing happens", f"{before}, then {again}")
    for _ in range(4):
        simulation.step(subject.moving(dz=subject.length(0.1)))
    moved = simulation.state_hash() != before
    yield from expect(moved, "another hash after the tool has moved", f"{before} again")


@check("picture", look="Simulation.picture")
def picture(subject: CheckedTask) -> Iterator[Violation]:
    """The picture for people is rendered, and leaves the state as it was."""
    simulation = subject.reset(3)
    before = simulation.state_hash()
    drawn = simulation.picture()
    yield from _array("the picture", drawn, (PICTURE_SIZE, PICTURE_SIZE, 3), np.dtype(np.uint8))
    visible = not subject.simulator.renders or np.std(drawn) >= FLAT
    seen = f"pixels that deviate by {np.std(drawn):.1f} of 255"
    yield from expect(visible, "a picture that shows something", seen)
    same = simulation.state_hash() == before
    yield from expect(same, "the same state after a picture", "another state hash")


@check("render-device", look="Simulation.render_device")
def render_device(subject: CheckedTask) -> Iterator[Violation]:
    """The render device has a name."""
    device = subject.simulation.render_device()
    named = isinstance(device, str) and device.strip() and "\n" not in device
    yield from expect(named, "the name of the render device, on one line", repr(device))


def _array(what: str, value: object, shape: tuple[int, ...] | None, dtype: np.dtype) -> Iterator[Violation]:
    """Yield a violation unless the value is a finite array of this shape (None for any) and type."""
    if not isinstance(value, np.ndarray):
        yield Violation(f"{what} as an array", type(value).__name__)
    elif value.dtype != dtype or shape not in (None, value.shape):
        wanted = f"{dtype}" if shape is None else f"{shape}, {dtype}"
        yield Violation(f"{what} as {wanted}", f"{value.shape}, {value.dtype}")
    elif not np.isfinite(value).all():
        yield Violation(f"{what} with finite numbers", _numbers(value))


def _numbers(values: np.ndarray) -> str:
    """Up to eight of them. Not in numpy's own format, which libraries change for the whole process."""
    return f"[{', '.join(f'{value:.3f}' for value in np.asarray(values, dtype=np.float64).ravel()[:8])}]"


def _listed(names: Set[str]) -> str:
    return ", ".join(sorted(names)) or "nothing"


CHECKS = (
    declaration,
    description,
    opens,
    specs,
    adjusts,
    observation,
    images,
    units,
    privileged_state,
    proprioception,
    step_outcome,
    state_hash,
    picture,
    render_device,
)
