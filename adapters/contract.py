"""The contract between RoboGauntlet and a simulator. Plug-ins rely on what this module exports.

Conventions, the same in every simulator:

- Frame: the robot's base, x forward, y left, z up; metres and radians.
- Action, 7 numbers per control step and arm: translation of the tool centre point (m), its rotation as an axis-angle
  vector in the base frame (rad), gripper (-1 open .. +1 closed).
- Proprioception, 8 numbers per arm: tool centre point position (m), its axis-angle on the branch around "gripper
  pointing down" (`robogauntlet.adapters.frames.axis_angle`, rad), positions of the two fingers (m).
- Joints, of any arm: an action has the target of each joint (rad), or its velocity (rad/s), and the gripper as before.
  Proprioception: angle of each joint (rad), gripper on the same scale.
- Two arms: the numbers of the first, then those of the second, each in the frame of its own base. All else, goals and
  behaviour among it, is in the frame of the first arm's base; names of the second arm begin with `second_`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.goals import Goal as Goal
from robogauntlet.suites.episode import CAMERAS, View

ACTION_NAMES = ("dx", "dy", "dz", "rx", "ry", "rz", "gripper")
PROPRIOCEPTION_NAMES = ("x", "y", "z", "rx", "ry", "rz", "finger_left", "finger_right")
GRIPPER, VELOCITY = "gripper", "_velocity"
ACTION_DIM, PROPRIOCEPTION_DIM = len(ACTION_NAMES), len(PROPRIOCEPTION_NAMES)
"""Of one arm whose tool is moved."""
ARM_PREFIXES = ("", "second_")
"""What the names of each arm's numbers begin with."""
PICTURE_SIZE = 256

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]


class AdapterError(Exception):
    """A problem with a simulator that its user can solve; the message says what to do."""


class SimulatorUnavailable(AdapterError):
    """The simulator is not installed, or cannot render on this machine."""


class UnknownTask(AdapterError):
    """No such task in this simulator."""


class TaskUnavailable(AdapterError):
    """The task cannot be played here, though others of its simulator can: it needs what is missing here."""


class UnsupportedCondition(AdapterError):
    """The simulation does not support this perturbation."""


class NotDelivered(AdapterError):
    """A perturbation did not change what it should, or changed something else."""


class Moves(StrEnum):
    """What the numbers of an action before the gripper's are."""

    TOOL = "motions of the tool"
    TARGETS = "targets of joints"
    VELOCITIES = "velocities of joints"


@dataclass(frozen=True)
class Body:
    """What acts, from which the numbers of an action and of proprioception follow."""

    arms: int = 1
    joints: tuple[str, ...] = ()
    """Names of an arm's joints, if an action has their targets or velocities; empty if it moves the tool."""
    velocities: bool = False
    """Whether an action has the velocities of `joints`, not their targets."""

    def __post_init__(self) -> None:
        """Check it. Raises ValueError for another number of arms, a joint's name, or velocities of no joints."""
        if self.arms not in (1, 2):
            raise ValueError(f"arms: expected 1 or 2, found {self.arms!r}")
        if self.velocities and not self.joints:
            raise ValueError("velocities: expected joints beside it, found none")
        if taken := {name for name in self.joints if name in ACTION_NAMES or self.joints.count(name) > 1}:
            raise ValueError(f"joints: expected a name for each, none of an action of a tool, found {min(taken)!r}")

    @property
    def moves(self) -> Moves:
        """What the numbers of an action before the gripper's are."""
        return (Moves.VELOCITIES if self.velocities else Moves.TARGETS) if self.joints else Moves.TOOL

    @property
    def action_names(self) -> tuple[str, ...]:
        """What each number of an action is."""
        joints = [joint + VELOCITY * self.velocities for joint in self.joints]
        return names_of_arms((*joints, GRIPPER) if joints else ACTION_NAMES, self.arms)

    @property
    def proprioception_names(self) -> tuple[str, ...]:
        """What each number of proprioception is."""
        return names_of_arms((*self.joints, GRIPPER) if self.joints else PROPRIOCEPTION_NAMES, self.arms)

    @property
    def action_dim(self) -> int:
        """Numbers of an action."""
        return len(self.action_names)

    @property
    def proprioception_dim(self) -> int:
        """Numbers of proprioception."""
        return len(self.proprioception_names)


@dataclass(frozen=True)
class Joint:
    """A joint whose target or velocity an action has; a velocity moves the target by as much in a control step."""

    name: str
    low: float
    """Least and greatest target (rad); others are clipped by the adapter."""
    high: float
    step: float
    """Largest change of the target in a control step (rad); more is clipped by the adapter."""


@dataclass(frozen=True)
class ActionSpec:
    """Parts and bounds of an action, in the units of the conventions above. They are the same for both of two arms."""

    max_translation: float
    """Largest translation per axis and step (m); more is clipped by the adapter. 0 if there are `joints`."""
    max_rotation: float
    """Largest rotation per axis and step (rad); more is clipped by the adapter. 0 if there are `joints`."""
    control_hz: float
    """Control steps per simulated second."""
    ignored: tuple[str, ...] = ()
    """Those out of `names` that have no effect in this task."""
    arms: int = 1
    joints: tuple[Joint, ...] = ()
    """Joints of an arm, in order, if an action has their targets or velocities; empty if it moves the tool."""
    velocities: bool = False
    """Whether an action has the velocities of `joints` (rad/s), not their targets (rad)."""

    def __post_init__(self) -> None:
        """Check what acts, see `Body`."""
        _ = self.body

    @property
    def body(self) -> Body:
        """What acts."""
        return Body(self.arms, tuple(joint.name for joint in self.joints), self.velocities)

    @property
    def names(self) -> tuple[str, ...]:
        """What each number of an action is, see `Body.action_names`."""
        return self.body.action_names

    @property
    def low(self) -> FloatArray:
        """Lower bounds, shape (numbers of an action,)."""
        if self.body.moves is not Moves.TARGETS:
            return -self.high
        return np.array([*(joint.low for joint in self.joints), -1.0] * self.arms)

    @property
    def high(self) -> FloatArray:
        """Upper bounds, shape (numbers of an action,)."""
        one = [self.max_translation] * 3 + [self.max_rotation] * 3
        if self.joints:
            one = [joint.step * self.control_hz if self.velocities else joint.high for joint in self.joints]
        return np.array([*one, 1.0] * self.arms)

    @property
    def steps(self) -> FloatArray:
        """Largest motion of each number in a control step, shape as `high`: that, or of targets their change (rad)."""
        if self.body.moves is not Moves.TARGETS:
            return self.high
        return np.array([*(joint.step for joint in self.joints), 2.0] * self.arms)

    @property
    def per_radian(self) -> float:
        """By how much the number of a joint grows for each radian that its target goes further in a control step."""
        return self.control_hz if self.velocities else 1.0

    def joints_of(self, arm: int) -> slice:
        """Return where an action has the joints of an arm, 0 or 1."""
        first = arm * (len(self.joints) + 1)
        return slice(first, first + len(self.joints))

    @property
    def ignored_indices(self) -> list[int]:
        """Positions in an action of the numbers that are `ignored`."""
        return [self.names.index(name) for name in self.ignored]


def is_of_second_arm(name: str) -> bool:
    """Return whether an entry of `privileged_state` is of the second arm, and no object or goal."""
    return name.startswith(ARM_PREFIXES[1])


def names_of_arms(names: Sequence[str], arms: int) -> tuple[str, ...]:
    """Return the names of each arm's numbers, given those of one arm."""
    return tuple(arm + name for arm in ARM_PREFIXES[:arms] for name in names)


@dataclass(frozen=True)
class ObservationSpec:
    """Cameras and size of the images that `observe` returns."""

    cameras: tuple[str, ...]
    image_size: int
    """Height and width (px)."""


@dataclass(frozen=True)
class Observation:
    """The input of a policy."""

    images: Mapping[str, Image]
    """Camera name to an upright RGB image, shape (size, size, 3)."""
    proprioception: FloatArray
    """Shape (numbers of `Body.proprioception_names`,), see the module's conventions."""
    instruction: str
    """The goal in words."""
    of_joints: bool = False
    """Whether proprioception has the positions of joints, and an action their targets or velocities."""
    hand_quaternion: FloatArray | None = None
    """The hand's orientation in the world, xyzw, shape (4,), with the sign of the engine, which a benchmark's own
    proprioception may depend on; None where no benchmark's does."""

    @property
    def action_dim(self) -> int:
        """Numbers of an action in answer to it, for the arms that it shows."""
        numbers = len(self.proprioception)
        return numbers if self.of_joints else numbers // PROPRIOCEPTION_DIM * ACTION_DIM


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """The result of one control step."""

    reward: float
    success: bool
    """Whether the task's predicate holds now; `rollout` decides whether it has held for long enough."""
    terminated: bool = False
    """The episode has ended: nobody steps the simulation further before a reset. `success` is then how it ended."""


@dataclass(frozen=True, slots=True)
class Delivered:
    """The measured effect of a perturbation in an episode, to compare with the requested level."""

    value: float | None
    """In the unit of its axis; None if it could not be measured, for example if a policy never observes."""
    statistics: Mapping[str, float] = field(default_factory=dict)
    """Further numbers by name, of the first images that the policy received or of the camera that was moved."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Robot and objects after a control step, from which behaviour is measured. Base frame."""

    tool: FloatArray
    """Position of the tool centre point, shape (3,) (m)."""
    opening: float
    """Distance between the fingers, the sum of their positions (m)."""
    entries: tuple[FloatArray, ...]
    """Values of the entries of `privileged_state` that were asked for, in order."""
    contact_force: float | None = None
    """Sum of the normal forces between the arms and all but themselves and the objects of the task (N)."""
    joint_margin: float | None = None
    """Distance of the arm's joints from their limits, the smallest; negative beyond one (rad)."""


class Simulation(Protocol):
    """One open task. Used by one thread of one process."""

    action_spec: ActionSpec
    observation_spec: ObservationSpec

    def reset(self, seed: int) -> None:
        """Start the clean episode of `seed`. Equal seeds give equal states, whatever was played before."""

    def observe(self) -> Observation:
        """Render the present state. The only call that renders for a policy."""

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action`, of the shape and within the bounds of `action_spec`, for a control step. Never renders."""

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return the true state in the base frame, for oracles and checks, never for policies.

        Always holds `tcp_position` (3,), `tcp_quaternion` (4,) xyzw and `finger_positions` (2,), and of a second arm
        `second_tcp_position` and so on in its own base's frame, and its base, `second_base_position` and
        `second_base_quaternion`, in the first's. Objects follow as `<name>_position` and `<name>_quaternion`, goals as
        `goal_position`. Where resets let objects come to rest, `settling_shift` (1,) is how far they slid (m). Where
        actions are of joints, each arm has `joint_angles` (n,) and `gripper` (1,) as in proprioception, its present
        `joint_targets` (n,) (rad), and `tcp_jacobian` (6, n): the tool's motion (m, rad) per radian.
        """

    def state_hash(self) -> str:
        """Return a hash of the full physical state, see `robogauntlet.adapters.frames.hash_state`."""

    def picture(self) -> Image:
        """Render the third-person view, (256, 256, 3), for videos and reports, never for policies."""

    def render_device(self) -> str:
        """Return the name of the renderer, such as `llvmpipe (LLVM 19.1.7)` or `TinyRenderer`."""

    def close(self) -> None:
        """Free everything. Safe to call twice."""


@runtime_checkable
class Measured(Protocol):
    """A `Simulation` that measures what it changed: under a perturbation, or of a task that is a variant of another."""

    def delivered(self) -> Delivered:
        """Return what was measured in this episode."""


@dataclass(frozen=True)
class TaskDescription:
    """A task, as its simulator declares it."""

    instruction: str
    """The goal in words, as policies receive it."""
    horizon: int
    """Control steps in which a competent policy succeeds comfortably."""
    fixed: Mapping[str, str] = field(default_factory=dict)
    """Scene control that the simulator has in other tasks but not in this one, to the reason."""
    cameras: tuple[str, ...] = CAMERAS
    """Its cameras, the third-person camera among them."""
    modules: tuple[str, ...] = ()
    """Modules that it needs beside its simulator's."""
    goal: Goal | None = None
    """Without it, progress and the kinds of failures are not measured."""
    published_instruction: str = ""
    """What the benchmark's own code gives, if it is another; see the control `variant-name`."""
    robot: str = ""
    """The robot that plays it, if others can: tasks with the same name before an `@` differ in it."""
    arms: int = 1
    """Arms that act in it, 1 or 2."""
    joints: tuple[str, ...] = ()
    """Names of an arm's joints, if an action has their targets or velocities; empty if it moves the tool."""
    velocities: bool = False
    """Whether an action has the velocities of `joints`, not their targets."""
    variant_of: str = ""
    """The task (`simulator/task`) of which it is a variant: who was trained on that one can act in this one."""
    start_states: int | None = None
    """Number of stored states in which it can start, which suites play once each; None if every seed has its own."""

    def __post_init__(self) -> None:
        """Check what acts, see `Body`."""
        _ = self.body

    @property
    def body(self) -> Body:
        """What acts."""
        return Body(self.arms, self.joints, self.velocities)


@dataclass(frozen=True)
class Simulator:
    """A simulator, as its entry point (group `robogauntlet.simulators`) declares it. Building one imports nothing."""

    name: str
    title: str
    """For people, such as `ManiSkill 3 (SAPIEN)`."""
    tasks: Mapping[str, TaskDescription]
    """Task name (without the simulator) to its description."""
    modules: tuple[str, ...]
    """Modules that must be installed."""
    distributions: tuple[str, ...]
    """Distributions whose versions belong to the provenance of a result."""
    open: Callable[[str, View], Simulation]
    """Imports the simulator and opens one of `tasks`, by name without the simulator. Raises SimulatorUnavailable."""
    environment: Mapping[str, str] = field(default_factory=dict)
    """Environment variables that a worker sets, unless set already, before the simulator is imported."""
    requirements: tuple[str, ...] = ()
    """Requirements that `robogauntlet env create` adds for a simulator that needs a Python environment of its own."""
    without_dependencies: tuple[str, ...] = ()
    """Further requirements, installed without their dependencies."""
    imports: str = ""
    """`MODULE:FUNCTION` that imports the simulator; `robogauntlet env list` calls it in its environment."""
    references: tuple[str, ...] = ()
    """BibTeX entries of the simulator, its tasks and its physics engine, for `robogauntlet report --cite`."""
    adjusts: frozenset[str] = frozenset()
    """Names of the scene controls of its simulations, out of `adapters.scene_control.ADJUSTABLE`."""
    renders: bool = True
    """False for simulators that do not render (the null simulator)."""
    newest_python: str = ""  # for which its packages have wheels, such as `3.12`; empty for any
    internal: bool = False
    """True for simulators that test the orchestrator; they are listed only on request."""
