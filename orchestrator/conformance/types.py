"""Types, shapes and units of everything that an adapter declares and returns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from adapters.adjusting import ADJUSTABLE
from adapters.contract import (
    ACTION_NAMES,
    PICTURE_SIZE,
    PROPRIOCEPTION_DIM,
    ActionSpec,
    Observation,
    ObservationSpec,
    StepOutcome,
    UnsupportedCondition,
)
from adapters.frames import axis_angle
from orchestrator.conformance.findings import Fault, check
from orchestrator.conformance.subject import CLEAN, Subject, describe
from suites.vocabulary import CAMERAS, Condition

FARTHEST = 2.0
"""Where a tool can be, seen from the base of an arm that stands on a table (m)."""
WIDEST = 0.2
"""Where a finger can be, seen from the middle (m)."""
FLAT = 5.0
"""Standard deviation of the pixels below which an image shows nothing."""
PER_STEP = {"max_translation": (1e-4, 0.2, "m"), "max_rotation": (0.0, 1.0, "rad"), "control_hz": (1.0, 1000.0, "1/s")}
"""What is plausible for one control step."""


@check("card", look="the Simulator that the entry point declares, and its TaskCards")
def card(subject: Subject) -> Iterator[Fault]:
    """The declaration is complete: instruction, horizon, adjustable parts and reasons."""
    simulator, told = subject.simulator, subject.card
    if not told.instruction.strip() or told.instruction != " ".join(told.instruction.split()):
        yield Fault("an instruction in words, on one line", repr(told.instruction))
    if type(told.horizon) is not int or told.horizon < 1:
        yield Fault("a horizon of 1 control step or more", repr(told.horizon))
    if unknown := simulator.adjusts - ADJUSTABLE:
        yield Fault(f"`adjusts` out of {', '.join(sorted(ADJUSTABLE))}", ", ".join(sorted(unknown)))
    if stray := told.fixed.keys() - simulator.adjusts:
        yield Fault("`fixed` to name what the simulator adjusts in other tasks", ", ".join(sorted(stray)))
    if mute := [name for name, reason in told.fixed.items() if not reason.strip()]:
        yield Fault("a reason for all that is `fixed`", f"none for {', '.join(mute)}")
    if set(told.cameras) - set(CAMERAS) or CAMERAS[0] not in told.cameras:
        yield Fault(
            f"`cameras` out of {', '.join(CAMERAS)}, {CAMERAS[0]} among them", ", ".join(told.cameras) or "none"
        )


@check("opens", look="Simulator.open, and reset")
def opens(subject: Subject) -> Iterator[Fault]:
    """The task opens and is reset without an error."""
    if subject.why_not_open is not None:
        yield Fault("the task to open", describe(subject.why_not_open))


@check("adjusts", look="`adjusters` of the simulation, `adjusts` of the Simulator, `fixed` of the TaskCard")
def adjusts(subject: Subject) -> Iterator[Fault]:
    """What can be adjusted is what is declared, less what is fixed in this task."""
    offered, declared = subject.adjusters.offered(), subject.simulator.adjusts - subject.card.fixed.keys()
    if offered != declared:
        yield Fault(_listed(declared), f"{_listed(offered)} offered by the simulation")


@check("specs", look="action_spec and observation_spec")
def specs(subject: Subject) -> Iterator[Fault]:
    """Specifications are in metres, radians and hertz, and show what was asked for."""
    action, seen = subject.simulation.action_spec, subject.simulation.observation_spec
    if not isinstance(action, ActionSpec) or not isinstance(seen, ObservationSpec):
        yield Fault("an ActionSpec and an ObservationSpec", f"{type(action).__name__}, {type(seen).__name__}")
        return
    for name, (low, high, unit) in PER_STEP.items():
        value = getattr(action, name)
        if not low <= value <= high:
            yield Fault(f"{name} of {low:g} to {high:g} {unit}", f"{value:g}")
    if unknown := set(action.ignored) - set(ACTION_NAMES):
        yield Fault(f"`ignored` out of {', '.join(ACTION_NAMES)}", ", ".join(sorted(unknown)))
    if action.max_rotation == 0.0 and not {"rx", "ry", "rz"} <= set(action.ignored):
        yield Fault("rotations declared in `ignored` where max_rotation is 0", f"ignored: {action.ignored}")
    asked = ObservationSpec(subject.view.cameras, subject.view.image_size)
    if (tuple(seen.cameras), seen.image_size) != (asked.cameras, asked.image_size):
        yield Fault(f"the cameras and the size that were asked for, {asked}", str(seen))


@check("observation", look="Simulation.observe")
def observation(subject: Subject) -> Iterator[Fault]:
    """An observation has the images that were asked for, proprioception and the instruction."""
    seen = subject.reset().observe()
    if not isinstance(seen, Observation):
        yield Fault("an Observation", type(seen).__name__)
        return
    if tuple(seen.images) != subject.view.cameras:
        yield Fault(f"images of {', '.join(subject.view.cameras)}, in this order", ", ".join(seen.images) or "none")
    size = subject.view.image_size
    for camera, image in seen.images.items():
        yield from _array(f"the image of {camera}", image, (size, size, 3), np.dtype(np.uint8))
    yield from _array("proprioception", seen.proprioception, (PROPRIOCEPTION_DIM,), np.dtype(np.float64))
    if seen.instruction != subject.card.instruction:
        yield Fault(f"the card's instruction, '{subject.card.instruction}'", repr(seen.instruction))


@check("images", look="Simulation.observe and the cameras' places", renders=True)
def images(subject: Subject) -> Iterator[Fault]:
    """Every camera shows something."""
    for camera, image in subject.reset().observe().images.items():
        if (contrast := float(np.std(image))) < FLAT:
            yield Fault(
                f"{camera} to show something, pixels that deviate by {FLAT:g} of 255 or more", f"{contrast:.1f}"
            )


@check("units", look="the base frame and the units of privileged_state and proprioception: metres, radians")
def units(subject: Subject) -> Iterator[Fault]:
    """The tool starts in front of the base, pointing down, in metres and radians."""
    simulation = subject.reset()
    state, seen = simulation.privileged_state(), simulation.observe().proprioception
    for name, position in (("tcp_position", state["tcp_position"]), ("proprioception[:3]", seen[:3])):
        if not np.abs(position).max() < FARTHEST:
            yield Fault(f"{name} within {FARTHEST:g} m of the base", _numbers(position))
        elif not (position[0] > 0.1 and abs(position[1]) < position[0]):
            yield Fault(f"{name} in front of the base: x forward, y left", f"{_numbers(position)} m")
    turn = float(np.linalg.norm(seen[3:6]))
    if not abs(turn - np.pi) < 0.35:
        yield Fault("proprioception[3:6] near (pi, 0, 0) rad, pointing down", f"{_numbers(seen[3:6])}: {turn:.2f} long")
    for name, fingers in (("finger_positions", state["finger_positions"]), ("proprioception[6:]", seen[6:])):
        if not np.abs(fingers).max() < WIDEST:
            yield Fault(f"{name} within {WIDEST:g} m of the middle", _numbers(fingers))


@check("privileged-state", look="Simulation.privileged_state")
def privileged_state(subject: Subject) -> Iterator[Fault]:
    """The privileged state has tool, fingers and things, as finite float64 arrays."""
    state = subject.reset().privileged_state()
    if not isinstance(state, Mapping):
        yield Fault("a mapping of names to arrays", type(state).__name__)
        return
    for name in ("tcp_position", "tcp_quaternion", "finger_positions"):
        if name not in state:
            yield Fault(f"`{name}`", f"{', '.join(sorted(state))}")
    shapes = {"_position": (3,), "_positions": (2,), "_quaternion": (4,)}
    for name, value in state.items():
        shape = next((shape for end, shape in shapes.items() if name.endswith(end)), None)
        yield from _array(name, value, shape, np.dtype(np.float64))
        if name.endswith("_quaternion") and np.shape(value) == (4,) and abs(np.linalg.norm(value) - 1.0) > 1e-4:
            yield Fault(f"{name} of length 1, xyzw", f"{_numbers(value)}: {np.linalg.norm(value):.3f} long")


@check("proprioception", look="proprioception in Simulation.observe, and privileged_state")
def proprioception(subject: Subject) -> Iterator[Fault]:
    """Proprioception agrees with the privileged state."""
    simulation = subject.reset(1)
    for action in subject.random_actions(5, 6):
        simulation.step(action)
    seen, state = simulation.observe().proprioception, simulation.privileged_state()
    parts = {
        "position, tcp_position": (seen[:3], state["tcp_position"], 1e-6),
        "axis-angle, axis_angle(tcp_quaternion)": (seen[3:6], axis_angle(state["tcp_quaternion"]), 1e-5),
        "fingers, finger_positions": (seen[6:], state["finger_positions"], 1e-6),
    }
    for name, (told, true, tolerance) in parts.items():
        if not np.allclose(told, true, atol=tolerance, rtol=0.0):
            yield Fault(f"{name}: {_numbers(true)}", _numbers(told))


@check("step-outcome", look="Simulation.step")
def step_outcome(subject: Subject) -> Iterator[Fault]:
    """A step answers with a finite reward, success and terminated, as plain Python."""
    outcome = subject.reset().step(subject.action())
    if not isinstance(outcome, StepOutcome):
        yield Fault("a StepOutcome", type(outcome).__name__)
        return
    if not isinstance(outcome.reward, float) or not np.isfinite(outcome.reward):
        yield Fault("a finite float as reward", f"{outcome.reward!r}, {type(outcome.reward).__name__}")
    for name, value in (("success", outcome.success), ("terminated", outcome.terminated)):
        if type(value) is not bool:
            yield Fault(f"a bool as {name}", f"{value!r}, {type(value).__name__}")


@check("state-hash", look="Simulation.state_hash")
def state_hash(subject: Subject) -> Iterator[Fault]:
    """The state hash is text, and changes as the world does."""
    simulation = subject.reset()
    before = simulation.state_hash()
    if not isinstance(before, str) or not before:
        yield Fault("text", repr(before))
    if simulation.state_hash() != before:
        yield Fault("the same hash while nothing happens", f"{before}, then {simulation.state_hash()}")
    for _ in range(4):
        simulation.step(subject.action(dz=subject.simulation.action_spec.max_translation))
    if simulation.state_hash() == before:
        yield Fault("another hash after the tool has moved", f"{before} again")


@check("picture", look="Simulation.picture")
def picture(subject: Subject) -> Iterator[Fault]:
    """The picture for people is drawn, and leaves the world as it was."""
    simulation = subject.reset(3)
    before = simulation.state_hash()
    drawn = simulation.picture()
    yield from _array("the picture", drawn, (PICTURE_SIZE, PICTURE_SIZE, 3), np.dtype(np.uint8))
    if subject.simulator.renders and np.std(drawn) < FLAT:
        yield Fault("a picture that shows something", f"pixels that deviate by {np.std(drawn):.1f} of 255")
    if simulation.state_hash() != before:
        yield Fault("the same world after a picture", "another state hash")


@check("render-device", look="Simulation.render_device")
def render_device(subject: Subject) -> Iterator[Fault]:
    """What draws has a name."""
    device = subject.simulation.render_device()
    if not isinstance(device, str) or not device.strip() or "\n" in device:
        yield Fault("the name of what draws, on one line", repr(device))


@check("unknown-condition", look="Simulation.reset")
def unknown_condition(subject: Subject) -> Iterator[Fault]:
    """A condition that cannot be brought about is refused with UnsupportedCondition."""
    try:
        subject.simulation.reset(0, Condition("no-such-axis", 3))
    except UnsupportedCondition:
        return
    finally:
        subject.simulation.reset(0, CLEAN)
    yield Fault("UnsupportedCondition for an axis that there is not", "it was accepted")


def _array(what: str, value: object, shape: tuple[int, ...] | None, dtype: np.dtype) -> Iterator[Fault]:
    """Faults of something that should be a finite array of this shape (None for any) and type."""
    if not isinstance(value, np.ndarray):
        yield Fault(f"{what} as an array", type(value).__name__)
    elif value.dtype != dtype or shape not in (None, value.shape):
        wanted = f"{dtype}" if shape is None else f"{shape}, {dtype}"
        yield Fault(f"{what} as {wanted}", f"{value.shape}, {value.dtype}")
    elif not np.isfinite(value).all():
        yield Fault(f"{what} with finite numbers", _numbers(value))


def _numbers(values: np.ndarray) -> str:
    """Up to eight of them. Not in numpy's own format, which libraries change for the whole process."""
    return f"[{', '.join(f'{value:.3f}' for value in np.asarray(values, dtype=np.float64).ravel()[:8])}]"


def _listed(names: frozenset[str] | set[str]) -> str:
    return ", ".join(sorted(names)) or "nothing"


CHECKS = (
    card,
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
    unknown_condition,
)
