"""Condition, view, protocol, episode and cell: frozen values that all packages share. Standard library only."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import cached_property

CLEAN = "clean"
CONTROLS = ("blind", "blank-instruction", "wrong-goal", "again")
"""Control conditions, which have one severity."""
CAMERAS = ("third_person", "wrist")
FIRST_TRAINING_SEED = 1_000_000
"""Seeds from here on are for training and development; those of suites begin at 0, and never share a starting state."""
SUCCESS_HOLD = 5
"""Control steps in a row for which a task's success predicate must hold before the episode counts as a success."""


class RenderProfile(StrEnum):
    """Detail of rendering, which is part of an episode's identity."""

    STANDARD = "standard"
    """As in the simulator's own benchmark, with shadows, reflections and multisampling where it has them."""
    FAST = "fast"
    """Without shadows, reflections and multisampling."""
    FAST_2 = "fast-2"
    """As `fast`, with the meshes of robots simplified to what an image shows, where that saves a quarter of a frame."""


@dataclass(frozen=True, slots=True, order=True)
class Condition:
    """Clean, one perturbation axis at one severity, or a control."""

    axis: str = CLEAN
    """Name of the perturbation axis or control, or `clean`."""
    severity: int = 0
    """0 for clean, 1 for a control, else 1 (mild) to 5 (extreme but solvable)."""

    def __str__(self) -> str:
        return self.axis if self.axis in (CLEAN, *CONTROLS) else f"{self.axis}@{self.severity}"


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

    @property
    def simulator(self) -> str:
        """The part of the task's name before the slash."""
        return self.task.partition("/")[0]

    @cached_property
    def pair_id(self) -> str:
        """Hash of everything except the policy: equal for the episodes that a paired comparison compares."""
        condition, protocol = asdict(self.condition), asdict(self.protocol)
        return content_hash({"task": self.task, "seed": self.seed, "condition": condition, "protocol": protocol})

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


def content_hash(content: object, *, length: int = 16) -> str:
    """Return SHA-256 of the canonical JSON of `content` (sorted keys, no spaces, no NaN), in hexadecimal digits."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:length]
