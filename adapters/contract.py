"""The contract between RoboGauntlet and a simulator. Plug-ins rely on what this module exports.

Conventions, the same in every simulator:

- Frame: the robot's base, x forward, y left, z up; metres and radians.
- Action, 7 numbers per control step: translation of the tool centre point (m), its rotation as an axis-angle vector
  in the base frame (rad), gripper (-1 open .. +1 closed).
- Proprioception, 8 numbers: tool centre point position (m), its axis-angle on the branch around "gripper pointing
  down" (`adapters.frames.axis_angle`, rad), positions of the two fingers (m).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from suites.vocabulary import CAMERAS, Condition, View

ACTION_NAMES = ("dx", "dy", "dz", "rx", "ry", "rz", "gripper")
ACTION_DIM = 7
PROPRIOCEPTION_DIM = 8
PICTURE_SIZE = 256

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]


class AdapterError(Exception):
    """Something about a simulator that its user can mend; the message says what and how."""


class SimulatorUnavailable(AdapterError):
    """The simulator is not installed, or cannot render on this machine."""


class UnknownTask(AdapterError):
    """No such task in this simulator."""


class UnsupportedCondition(AdapterError):
    """The adapter cannot bring about this condition."""


class NotDelivered(AdapterError):
    """A perturbation did not change what it should, or changed something else."""


@dataclass(frozen=True)
class ActionSpec:
    """What one control step accepts, in the units of the convention above."""

    max_translation: float
    """Largest translation per axis and step (m); more is clipped by the adapter."""
    max_rotation: float
    """Largest rotation per axis and step (rad); more is clipped by the adapter."""
    control_hz: float
    """Control steps per simulated second."""
    ignored: tuple[str, ...] = ()
    """Names out of `ACTION_NAMES` that have no effect in this task."""

    @property
    def low(self) -> FloatArray:
        """Lower bounds, shape (7,)."""
        return -self.high

    @property
    def high(self) -> FloatArray:
        """Upper bounds, shape (7,)."""
        return np.array([self.max_translation] * 3 + [self.max_rotation] * 3 + [1.0])


@dataclass(frozen=True)
class ObservationSpec:
    """What `observe` returns."""

    cameras: tuple[str, ...]
    image_size: int
    """Height and width (px)."""


@dataclass(frozen=True)
class Observation:
    """What a policy may see."""

    images: Mapping[str, Image]
    """Camera name to an upright RGB image, shape (size, size, 3)."""
    proprioception: FloatArray
    """Shape (8,), see the module's conventions."""
    instruction: str
    """The goal in words."""


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """What one control step led to."""

    reward: float
    success: bool
    """The task's own predicate, now; `rollout` decides when it has held for long enough."""
    terminated: bool = False
    """The simulation cannot be stepped further."""


@dataclass(frozen=True, slots=True)
class Delivered:
    """What a perturbation amounted to in an episode, as measured; to be compared with what was asked for."""

    value: float | None
    """In the unit of its axis; None if nothing was there to be measured, as when a policy never looks."""
    statistics: Mapping[str, float] = field(default_factory=dict)
    """Other numbers, by name: of the first images that the policy was given, or of the camera that was moved."""


class Simulation(Protocol):
    """One open task. Used by one thread of one process."""

    action_spec: ActionSpec
    observation_spec: ObservationSpec

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode of `seed`. Nothing of an earlier episode is left: equal arguments, equal world.

        Raises:
            UnsupportedCondition: This adapter cannot bring `condition` about.
        """

    def observe(self) -> Observation:
        """Render the world as it is now. The only call that renders for a policy."""

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action`, shape (7,), within the bounds of `action_spec`, for one control step. Never renders."""

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """The true state in the base frame, for oracles and checks, never for policies.

        Always holds `tcp_position` (3,), `tcp_quaternion` (4,) xyzw and `finger_positions` (2,). Objects follow as
        `<name>_position` and `<name>_quaternion`, goals as `goal_position`. Where resets let things come to rest,
        `settling_shift` (1,) says how far they slid meanwhile (m).
        """

    def state_hash(self) -> str:
        """Hash of the full physical state, see `adapters.frames.hash_state`."""

    def picture(self) -> Image:
        """The third-person view for people, (256, 256, 3): for videos and reports, never for policies."""

    def render_device(self) -> str:
        """What draws the images, such as `llvmpipe (LLVM 19.1.7)` or `TinyRenderer`."""

    def close(self) -> None:
        """Free everything. Safe to call twice."""


class SimulationBatch(Protocol):
    """Open simulations of one task that are stepped and looked at together, such as ManiSkill's on a GPU.

    A member is a simulation like any other, but for `step` and `observe`, which its batch does. What one member does
    changes nothing in another. Used by one thread of one process.
    """

    members: Sequence[Simulation]

    def step(self, actions: Mapping[int, FloatArray]) -> Mapping[int, StepOutcome]:
        """One control step of these members, by number; the others stay as they are."""

    def observe(self, members: Sequence[int]) -> Mapping[int, Observation]:
        """What each of these members looks like now. The only call that renders for a policy."""

    def close(self) -> None:
        """Free everything. Safe to call twice."""


@dataclass(frozen=True)
class TaskCard:
    """A task, as the catalog shows it."""

    instruction: str
    """The goal in words, as a policy is told it."""
    horizon: int
    """Control steps that a competent policy needs with a comfortable margin."""
    fixed: Mapping[str, str] = field(default_factory=dict)
    """What of its world cannot be adjusted in this task although the simulator adjusts it in others, to the reason."""
    cameras: tuple[str, ...] = CAMERAS
    """What it can be looked at with, the third-person camera among them."""


@dataclass(frozen=True)
class Simulator:
    """A simulator, as its entry point (group `robogauntlet.simulators`) declares it. Building one imports nothing."""

    name: str
    title: str
    """For people, such as `ManiSkill 3 (SAPIEN)`."""
    tasks: Mapping[str, TaskCard]
    """Task name (without the simulator) to its card."""
    modules: tuple[str, ...]
    """Import names that must be installed."""
    distributions: tuple[str, ...]
    """Distributions whose versions belong to the provenance of a result."""
    open: Callable[[str, View], Simulation]
    """Opens one of `tasks`, by its name without the simulator. Imports the simulator, within the calling process.

    Raises SimulatorUnavailable."""
    open_batch: Callable[[str, View, int], SimulationBatch] | None = None
    """Opens so many of one task that share an engine; None if the simulator has none, and they are opened one by one.

    Raises SimulatorUnavailable."""
    environment: Mapping[str, str] = field(default_factory=dict)
    """Environment variables that a worker sets, unless set already, before the simulator is imported."""
    requirements: tuple[str, ...] = ()
    """What pip installs, on top of the running environment, for a simulator that does not fit in there (`gauntlet env
    create`); empty if it needs no Python environment of its own."""
    without_dependencies: tuple[str, ...] = ()
    """The same, without what these distributions name as their dependencies."""
    definitions: Mapping[str, str] = field(default_factory=dict)
    """Task to the hash of the file that defines it, where users write such files: a task that changes under its name is
    then another task to runs that are continued or compared."""
    adjusts: frozenset[str] = frozenset()
    """What of its world its simulations let perturbations adjust, out of `adapters.adjusting.ADJUSTABLE`."""
    renders: bool = True
    """False for simulators that draw nothing (the null simulator)."""
    internal: bool = False
    """True for simulators that exist to test the orchestrator: not listed unless asked for."""
