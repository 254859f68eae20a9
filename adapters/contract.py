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
- Native: numbers of an action and of proprioception are the environment's own, by name, in its units and bounds. There
  is no tool, joint or gripper, and behaviour is not measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.body import (
    ACTION_DIM as ACTION_DIM,
    ACTION_NAMES as ACTION_NAMES,
    ARM_PREFIXES as ARM_PREFIXES,
    GRIPPER as GRIPPER,
    PROPRIOCEPTION_DIM as PROPRIOCEPTION_DIM,
    PROPRIOCEPTION_NAMES as PROPRIOCEPTION_NAMES,
    VELOCITY as VELOCITY,
    ActionSpec as ActionSpec,
    Body as Body,
    FloatArray as FloatArray,
    Joint as Joint,
    Moves as Moves,
    Number as Number,
    is_of_second_arm as is_of_second_arm,
    names_of_arms as names_of_arms,
)
from robogauntlet.adapters.goals import Goal as Goal
from robogauntlet.suites.episode import CAMERAS, View

PICTURE_SIZE = 256

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
    native: int | None = None
    """Numbers of an action, where these and proprioception are the environment's own."""
    hand_quaternion: FloatArray | None = None
    """The hand's orientation in the world, xyzw, shape (4,), with the sign of the engine, which a benchmark's own
    proprioception may depend on; None where no benchmark's does."""

    @property
    def action_dim(self) -> int:
        """Numbers of an action in answer to it, for the arms that it shows."""
        if self.native is not None:
            return self.native
        numbers = len(self.proprioception)
        return numbers if self.of_joints else numbers // PROPRIOCEPTION_DIM * ACTION_DIM


def black_observation(view: View, body: Body, instruction: str = "") -> Observation:
    """Return an observation of black images and zeros, to ask a policy before a simulation is open."""
    images = {camera: np.zeros((view.image_size, view.image_size, 3), np.uint8) for camera in view.cameras}
    native = len(body.native) or None
    return Observation(images, np.zeros(body.proprioception_dim), instruction, bool(body.joints), native)


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """The result of one control step."""

    reward: float
    success: bool
    """Whether the task's predicate holds now; `rollout` decides whether it has held for long enough."""
    terminated: bool = False
    """The episode has ended: nobody steps the simulation further before a reset. `success` is then how it ended."""


PENDING = StepOutcome(math.nan, success=False)
"""Returned by the step of a world that steps with others, see `BatchSimulation`: what comes of it is not known yet."""


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
        `joint_targets` (n,) (rad), and `tcp_jacobian` (6, n): the tool's motion (m, rad) per radian. Where numbers are
        the environment's own, it holds `state` (n,), as in proprioception, and `still`, an action that moves nothing,
        as far as there is one; nothing of a tool or fingers.
        """

    def state_hash(self) -> str:
        """Return a hash of the full physical state, see `robogauntlet.adapters.frames.hash_state`."""

    def picture(self) -> Image:
        """Render the third-person view, (256, 256, 3), for videos and reports, never for policies."""

    def render_device(self) -> str:
        """Return the name of the renderer, such as `llvmpipe (LLVM 19.1.7)` or `TinyRenderer`."""

    def close(self) -> None:
        """Free everything. Safe to call twice."""


class BatchSimulation(Protocol):
    """Worlds of one task that step together. Used by one thread of one process."""

    @property
    def worlds(self) -> Sequence[Simulation]:
        """The worlds. `step` of one notes the action and returns `PENDING`; reset and observe it at any time.

        What happens in it depends on the seed of its reset and on its actions, not on its place, on the number of the
        others or on what they do. The last one that is closed frees what they share.
        """

    def advance(self) -> Sequence[StepOutcome | None]:
        """Apply the noted actions for a control step. Return the outcome of each, None of a world that had none."""


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
    native: tuple[str, ...] = ()
    """Names of an action's numbers, if they are the environment's own."""
    state: tuple[str, ...] = ()
    """Names of the numbers of proprioception beside `native` ones."""
    own_words: bool = False
    """Whether each episode says the goal in words of its own, of which `instruction` is an example."""
    variant_of: str = ""
    """The task (`simulator/task`) of which it is a variant: who was trained on that one can act in this one."""
    start_states: int | None = None
    """Number of stored states in which it can start, which suites play once each; None if every seed has its own."""

    def __post_init__(self) -> None:
        """Check what acts, see `Body`. Raises ValueError for a goal where nothing shows a tool."""
        if self.body.native and self.goal is not None:
            raise ValueError("goal: expected none beside native numbers, whose tool is unknown")

    @property
    def body(self) -> Body:
        """What acts."""
        return Body(self.arms, self.joints, self.velocities, self.native, self.state)


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
    has_assets: bool = False
    """Whether it finds assets of the user's in the folder of `user_assets.variable`."""
    renders: bool = True
    """False for simulators that do not render (the null simulator)."""
    newest_python: str = ""  # for which its packages have wheels, such as `3.12`; empty for any
    internal: bool = False
    """True for simulators that test the orchestrator; they are listed only on request."""
