"""Condition, view, protocol, episode and cell: frozen values that all packages share. Standard library only."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any

from robogauntlet.suites.timing import Timing

CLEAN = "clean"
CONTROLS = ("blind", "blank-instruction", "wrong-goal", "variant-name", "resampled", "again")
"""Control conditions, which have one severity."""
CAMERAS = ("third_person", "wrist")
AT, AND = "@", "+"
"""Signs in the text of a combination."""
_PART = re.compile(r"(?P<axis>[^@+]+)@(?P<severity>[0-9]{1,3}([.][0-9]{1,2})?)")
AXIS_VERSIONS = {"action-delay": 2, "distractors": 2, "dynamics": 2, "robot-start": 2}
"""Axes that do something else than in their first version. An episode's ids depend on it, so that it has no pair among
episodes of another version. `Episode.axis_version` has what changed."""
LATEST = max(AXIS_VERSIONS.values())
FIRST_TRAINING_SEED = 1_000_000
"""Seeds from here on are for training and development; those of suites begin at 0, and never share a starting state."""
SUCCESS_HOLD = 5
"""Control steps in a row for which a task's success predicate must hold by the rule `held`."""


class RenderProfile(StrEnum):
    """Detail of rendering, which is part of an episode's identity."""

    STANDARD = "standard"
    """As in the simulator's own benchmark, with shadows, reflections and multisampling where it has them."""
    FAST = "fast"
    """Without shadows, reflections and multisampling."""
    FAST_2 = "fast-2"
    """As `fast`, with the meshes of robots simplified to what an image shows, where that saves a quarter of a frame."""


class SuccessRule(StrEnum):
    """When an episode is a success, at which it ends."""

    HELD = "held"
    """The task's predicate has held for `SUCCESS_HOLD` control steps in a row."""
    ONCE = "once"
    """The predicate holds after a control step, as most benchmarks count."""


class ProtocolName(StrEnum):
    """Whose rules decide when an episode is a success, unless a rule is stated, and how images are turned."""

    ROBOGAUNTLET = "robogauntlet"
    """The predicate is held; images are upright."""
    OPENVLA = "openvla"
    """As in evaluations on LIBERO since OpenVLA's: the predicate holds once; LIBERO's images, which are upside down,
    are rotated by 180 degrees, which makes them upright and mirrored."""

    @property
    def success_rule(self) -> SuccessRule:
        """The protocol's own rule."""
        return SuccessRule.ONCE if self is ProtocolName.OPENVLA else SuccessRule.HELD


@dataclass(frozen=True, slots=True, order=True)
class Perturbation:
    """One perturbation axis, or control, at one severity."""

    axis: str
    severity: float
    """Above 0 (clean) and up to 5, in hundredths; the axis' scale is interpolated between whole severities."""

    def __str__(self) -> str:
        return f"{self.axis}{AT}{self.severity:g}"


@dataclass(frozen=True, slots=True, order=True)
class Condition:
    """Clean, one perturbation axis at one severity, a control, or a combination of axes.

    A combination, or one axis at a fractional severity, is named by its perturbations: its `axis` is
    `camera-orbit@2+illuminance@3.5` (sorted by name) and its `severity` 1. See `Condition.of`.
    """

    axis: str = CLEAN
    """Name of the perturbation axis or control, `clean`, or the perturbations of a combination."""
    severity: int = 0
    """0 for clean, 1 for a control or combination, else 1 (mild) to 5 (extreme)."""

    def __str__(self) -> str:
        named = self.axis in (CLEAN, *CONTROLS) or self.is_combination
        return self.axis if named else f"{self.axis}@{self.severity}"

    @classmethod
    def of(cls, *perturbations: Perturbation) -> Condition:
        """Return the condition with these perturbations; equal ones have one spelling.

        Severities are rounded to hundredths, and those of 0 are left out.

        Raises:
            ValueError: An axis is given twice.
        """
        rounded = (Perturbation(one.axis, round(one.severity, 2)) for one in perturbations)
        parts = sorted(one for one in rounded if one.severity)
        axes = [part.axis for part in parts]
        if repeated := next((axis for axis in axes if axes.count(axis) > 1), None):
            raise ValueError(f"expected each axis once, got '{repeated}' twice")
        if not parts:
            return cls()
        if len(parts) == 1 and parts[0].severity == int(parts[0].severity):
            return cls(parts[0].axis, int(parts[0].severity))
        return cls(AND.join(map(str, parts)), 1)

    @property
    def is_on_scale(self) -> bool:
        """Whether this is one axis at one of its whole severities."""
        return self.axis not in (CLEAN, *CONTROLS) and not self.is_combination

    @property
    def is_combination(self) -> bool:
        """Whether `axis` spells out perturbations: several, or one at a fractional severity."""
        return AT in self.axis

    @property
    def perturbations(self) -> tuple[Perturbation, ...]:
        """What is perturbed, and how much; nothing if clean.

        Raises:
            ValueError: The axis is no spelling of a combination.
        """
        if self == Condition():
            return ()
        if not self.is_combination:
            return (Perturbation(self.axis, self.severity),)
        parts = []
        for text in self.axis.split(AND):
            match = _PART.fullmatch(text)
            parts += [Perturbation(match["axis"], float(match["severity"]))] if match else []
        if len(parts) <= self.axis.count(AND) or Condition.of(*parts) != self:
            raise ValueError(f"expected a combination such as camera-orbit@2+illuminance@3.5, got '{self}'")
        return tuple(parts)


@dataclass(frozen=True, slots=True)
class View:
    """The images that a simulation renders for a policy."""

    cameras: tuple[str, ...] = CAMERAS
    """Names out of `CAMERAS`, in the order in which the policy receives them."""
    image_size: int = 96
    """Height and width of each image, in pixels."""
    render_profile: RenderProfile = RenderProfile.STANDARD


@dataclass(frozen=True, slots=True)
class Protocol:
    """The rules under which an episode is played."""

    horizon: int
    """Control steps after which an episode without success is a failure."""
    replan_every: int = 8
    """Steps of an action chunk that are executed before the policy is queried again (fewer for shorter chunks)."""
    view: View = field(default_factory=View)
    name: ProtocolName = ProtocolName.ROBOGAUNTLET
    success: SuccessRule | None = None
    """Another rule than the protocol's own, or None."""
    timing: Timing | None = None
    """How long answers take and what the robot does meanwhile; None: the simulation waits for them."""

    def __post_init__(self) -> None:
        """Give protocols with the same rules one spelling."""
        if self.success is self.name.success_rule:
            object.__setattr__(self, "success", None)

    @property
    def success_rule(self) -> SuccessRule:
        """When an episode is a success."""
        return self.success or self.name.success_rule

    @property
    def success_hold(self) -> int:
        """Control steps in a row for which the success predicate must hold."""
        return SUCCESS_HOLD if self.success_rule is SuccessRule.HELD else 1

    @property
    def mirrored(self) -> bool:
        """Whether policies see mirrored images."""
        return self.name is ProtocolName.OPENVLA

    def described(self) -> dict[str, Any]:
        """Return the fields.

        Those of RoboGauntlet's own protocol, of a protocol's own rule and of a simulation that waits are left out, as
        ids and datasets are older than names of protocols, rules and timing.
        """
        fields = _fields(self) | {"view": _fields(self.view)}
        if self.name is ProtocolName.ROBOGAUNTLET:
            del fields["name"]
        if self.success is None:
            del fields["success"]
        if self.timing is None:
            del fields["timing"]
        else:
            fields["timing"] = str(self.timing)
        return fields


@dataclass(frozen=True)
class Episode:
    """One policy on one task under one condition from one seed. Its ids are the same on every machine."""

    policy: str
    """The policy's name in the suite: a label, not part of the identity."""
    policy_digest: str
    """Hash of the policy's content. Two names for one content are one policy."""
    task: str
    """`simulator/task`, such as `maniskill/PushCube-v1`."""
    seed: int
    protocol: Protocol
    condition: Condition = Condition()
    axis_version: int = LATEST
    """The axes are those of this version: in 2, half steps of a delay are rounded up, all distractors
    are seen, friction is that of each contact instead of the object's own coefficient, and PyBullet turns the arm."""

    @property
    def simulator(self) -> str:
        """The part of the task's name before the slash."""
        return self.task.partition("/")[0]

    @cached_property
    def pair_id(self) -> str:
        """Hash of everything except the policy: equal for the episodes that a paired comparison compares."""
        condition, protocol = _fields(self.condition), self.protocol.described()
        content = {"task": self.task, "seed": self.seed, "condition": condition, "protocol": protocol}
        names = (part.partition(AT)[0] for part in self.condition.axis.split(AND))
        versions = {name: min(self.axis_version, AXIS_VERSIONS.get(name, 1)) for name in names}
        if later := {name: version for name, version in versions.items() if version > 1}:
            content["axis_versions"] = later  # ids are older than versions
        return content_hash(content)

    @cached_property
    def id(self) -> str:
        """Hash of the policy's content and everything in `pair_id`."""
        return content_hash({"pair": self.pair_id, "policy": self.policy_digest})


@dataclass(frozen=True)
class Cell:
    """One policy on one task under one condition: episodes that differ only in their seed."""

    policy: str
    policy_digest: str
    task: str
    protocol: Protocol
    condition: Condition = Condition()

    @property
    def simulator(self) -> str:
        """The part of the task's name before the slash."""
        return self.task.partition("/")[0]

    def episode(self, seed: int) -> Episode:
        """Return the cell's episode with this seed."""
        return Episode(self.policy, self.policy_digest, self.task, seed, self.protocol, self.condition)


def _fields(value: Any) -> dict[str, Any]:
    """The fields of a frozen value with slots: `dataclasses.asdict` would copy each one deeply."""
    return {name: getattr(value, name) for name in value.__slots__}


_CANONICAL = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def content_hash(content: object, *, length: int = 16) -> str:
    """Return SHA-256 of the canonical JSON of `content` (sorted keys, no spaces, no NaN), in hexadecimal digits."""
    return hashlib.sha256(_CANONICAL.encode(content).encode()).hexdigest()[:length]
