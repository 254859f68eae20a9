"""What acts in a task, and the numbers of its actions and proprioception. Exported by `.contract`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

ACTION_NAMES = ("dx", "dy", "dz", "rx", "ry", "rz", "gripper")
PROPRIOCEPTION_NAMES = ("x", "y", "z", "rx", "ry", "rz", "finger_left", "finger_right")
GRIPPER, VELOCITY = "gripper", "_velocity"
ACTION_DIM, PROPRIOCEPTION_DIM = len(ACTION_NAMES), len(PROPRIOCEPTION_NAMES)
"""Of one arm whose tool is moved."""
ARM_PREFIXES = ("", "second_")
"""What the names of each arm's numbers begin with."""

NO_METRES = "an action is of the environment's own numbers, which no length moves"
"""Why native numbers have no noise of their motion."""

FloatArray = NDArray[np.float64]


class Moves(StrEnum):
    """What the numbers of an action before the gripper's are."""

    TOOL = "motions of the tool"
    TARGETS = "targets of joints"
    VELOCITIES = "velocities of joints"
    NATIVE = "numbers of the environment's own"


@dataclass(frozen=True)
class Body:
    """What acts, from which the numbers of an action and of proprioception follow."""

    arms: int = 1
    joints: tuple[str, ...] = ()
    """Names of an arm's joints, if an action has their targets or velocities; empty if it moves the tool."""
    velocities: bool = False
    """Whether an action has the velocities of `joints`, not their targets."""
    native: tuple[str, ...] = ()
    """Names of an action's numbers, if they are the environment's own."""
    state: tuple[str, ...] = ()
    """Names of the numbers of proprioception beside `native` ones."""

    def __post_init__(self) -> None:
        """Check it.

        Raises:
            ValueError: It has another number of arms, a joint of a wrong name, velocities of no joints, or native
                numbers beside others or of one name.
        """
        if self.arms not in (1, 2):
            raise ValueError(f"arms: expected 1 or 2, found {self.arms!r}")
        if self.native and (self.joints or self.arms > 1):
            raise ValueError("native: expected no joints and one arm beside it")
        if self.state and not self.native:
            raise ValueError("state: expected native beside it, found none")
        for names in (self.native, self.state):
            if twice := {name for name in names if names.count(name) > 1}:
                raise ValueError(f"native: expected another name for each number, found {min(twice)!r} twice")
        if self.velocities and not self.joints:
            raise ValueError("velocities: expected joints beside it, found none")
        if taken := {name for name in self.joints if name in ACTION_NAMES or self.joints.count(name) > 1}:
            raise ValueError(f"joints: expected a name for each, none of an action of a tool, found {min(taken)!r}")

    @property
    def moves(self) -> Moves:
        """What the numbers of an action before the gripper's are."""
        if self.native:
            return Moves.NATIVE
        return (Moves.VELOCITIES if self.velocities else Moves.TARGETS) if self.joints else Moves.TOOL

    @property
    def action_names(self) -> tuple[str, ...]:
        """What each number of an action is."""
        if self.native:
            return self.native
        joints = [joint + VELOCITY * self.velocities for joint in self.joints]
        return names_of_arms((*joints, GRIPPER) if joints else ACTION_NAMES, self.arms)

    @property
    def proprioception_names(self) -> tuple[str, ...]:
        """What each number of proprioception is."""
        if self.native:
            return self.state
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
class Number:
    """A number of an action that is the environment's own, in its unit."""

    name: str
    low: float = -math.inf
    high: float = math.inf
    """Others are clipped by the adapter."""


@dataclass(frozen=True)
class ActionSpec:
    """Parts and bounds of an action, in the units of the conventions above. They are the same for both of two arms."""

    max_translation: float
    """Largest translation per axis and step (m); more is clipped by the adapter. 0 if no tool is moved."""
    max_rotation: float
    """Largest rotation per axis and step (rad); more is clipped by the adapter. 0 if no tool is moved."""
    control_hz: float
    """Control steps per simulated second."""
    ignored: tuple[str, ...] = ()
    """Those out of `names` that have no effect in this task."""
    arms: int = 1
    joints: tuple[Joint, ...] = ()
    """Joints of an arm, in order, if an action has their targets or velocities; empty if it moves the tool."""
    velocities: bool = False
    """Whether an action has the velocities of `joints` (rad/s), not their targets (rad)."""
    numbers: tuple[Number, ...] = ()
    """The numbers of an action, if they are the environment's own."""
    state: tuple[str, ...] = ()
    """Names of the numbers of proprioception beside `numbers`."""

    def __post_init__(self) -> None:
        """Check what acts, see `Body`."""
        _ = self.body

    @property
    def body(self) -> Body:
        """What acts."""
        joints, numbers = ([one.name for one in some] for some in (self.joints, self.numbers))
        return Body(self.arms, tuple(joints), self.velocities, tuple(numbers), self.state)

    @property
    def names(self) -> tuple[str, ...]:
        """What each number of an action is, see `Body.action_names`."""
        return self.body.action_names

    @property
    def low(self) -> FloatArray:
        """Lower bounds, shape (numbers of an action,)."""
        if self.numbers:
            return np.array([number.low for number in self.numbers])
        if self.body.moves is not Moves.TARGETS:
            return -self.high
        return np.array([*(joint.low for joint in self.joints), -1.0] * self.arms)

    @property
    def high(self) -> FloatArray:
        """Upper bounds, shape (numbers of an action,)."""
        if self.numbers:
            return np.array([number.high for number in self.numbers])
        one = [self.max_translation] * 3 + [self.max_rotation] * 3
        if self.joints:
            one = [joint.step * self.control_hz if self.velocities else joint.high for joint in self.joints]
        return np.array([*one, 1.0] * self.arms)

    @property
    def steps(self) -> FloatArray:
        """Largest motion of each number in a control step, shape as `high`: that, or of targets their change (rad)."""
        if self.numbers:
            return self.high - self.low
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
