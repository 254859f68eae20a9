"""The contract between RoboGauntlet and a policy. Plug-ins rely on what this module exports."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from robogauntlet.adapters.catalog import body_of, original
from robogauntlet.adapters.contract import ACTION_DIM, ActionSpec, Body, FloatArray, Moves, Observation, ObservationSpec
from robogauntlet.suites.episode import Episode
from robogauntlet.support.errors import UserError, first_line
from robogauntlet.support.text import first_of

SHOWN_TASKS = 10
"""Tasks in a message."""
MOST_SCORES, LONGEST_NAME = 1000, 200
"""Scores of a router, and characters of the name of one: each is stored with its episode."""


class PolicyError(UserError):
    """An error that the policy's user can fix; the message says how."""

    @property
    def reason(self) -> str:
        """The message without the name of a kind or function that it begins with, to follow the policy's own name."""
        return re.sub(r"^policy '[^']*': ", "", str(self))


class PolicyNotInstalled(PolicyError):
    """The packages or the environment that a policy needs are missing; the message says how to install them."""


class PolicyUnreachable(PolicyError):
    """The server of a policy does not answer."""


class PolicyMismatch(PolicyError):
    """A policy whose actions or inputs do not fit the simulation."""


class PolicyInput(StrEnum):
    """The input of a policy's query."""

    NOTHING = "nothing"
    OBSERVATION = "observation"
    """Images, proprioception and instruction; costs a rendering."""
    PRIVILEGED_STATE = "privileged_state"
    """The true state: oracles only."""


@dataclass(frozen=True)
class PolicySpec:
    """What a policy needs and produces, checked against the simulation before the first step."""

    sees: PolicyInput
    chunk_length: int
    """Largest number of actions in a chunk that the policy returns."""
    action_dim: int | None = ACTION_DIM
    """Numbers of an action, or None for as many as the task has. With a number and no `moves`, they are of robots."""
    cameras: tuple[str, ...] = ()
    """Cameras without which the policy cannot act."""
    image_size: int | None = None
    """Height and width (px) of its images, or None for any."""
    tasks: frozenset[str] | None = None
    """Tasks (`simulator/task`) in which it can act, or None for all."""
    variants: bool = False
    """Whether it can act in variants of these tasks too."""
    moves: Moves | None = None
    """What the numbers of an action before the gripper's are, or None for what they are in the task."""

    def can_act_in(self, task: str) -> bool:
        """Return whether it can act in `simulator/task`."""
        if self.misfit(body_of(task)):
            return False
        return self.tasks is None or task in self.tasks or (self.variants and original(task) in self.tasks)

    def misfit(self, body: Body) -> str | None:
        """Return what a body accepts and the policy produces instead, or None if its actions fit."""
        if self.action_dim not in (None, body.action_dim):
            return f"accepts {body.action_dim} numbers per action, the policy produces {self.action_dim}"
        if self.moves not in (None, body.moves):
            return f"accepts {body.moves}, the policy produces {self.moves}"
        if body.native and self.moves is None and self.action_dim is not None:
            return f"accepts {body.moves}, the policy produces those of a robot"
        return None


@dataclass(frozen=True)
class Wishes:
    """What a policy asks of a suite, which decides where the suite states it. Else the suite does as asked."""

    image_size: int | None = None
    """Height and width (px) of frames that are not enlarged for it, or None for any."""
    execute: int | None = None
    """Actions of a chunk that are executed before it is asked again, or None for what the suite says."""


@dataclass(frozen=True)
class Query:
    """A request for the next action chunk of one episode."""

    episode: Episode
    step: int
    """Control steps taken so far."""
    observation: Observation | None = None
    """Present if the policy sees observations."""
    privileged_state: Mapping[str, FloatArray] | None = None
    """Present if the policy sees the privileged state."""
    action_spec: ActionSpec | None = None
    """Bounds of an action, in a run. A policy server is not told."""
    still: FloatArray | None = None
    """An action that keeps the arms where they are, with open grippers; present if the policy sees nothing."""

    @property
    def action_dim(self) -> int:
        """Numbers of an action that answers it: those of what it shows, or else of its task."""
        return body_of(self.episode.task).action_dim if self.observation is None else self.observation.action_dim


@dataclass(frozen=True)
class Routing:
    """How a merged policy inferred its task."""

    scores: Mapping[str, float]
    """Expert to score, higher is likelier. Logarithms of probabilities where their exponentials add up to 1; a report
    then says how well they are calibrated. In a record, the expert of the episode's task has the task's name
    (`simulator/task`), so that a choice is right if it is the task."""
    choice: str
    latency_s: float
    unknown: float | None = None
    """Distance of the observation from every known task, higher is less alike; None if the router has no such score."""
    rejected: bool | None = None
    """Whether `unknown` exceeds the router's threshold; None if it has none."""


@dataclass(frozen=True)
class Decision:
    """A policy's answer to one query."""

    actions: FloatArray
    """Action chunk, shape (n, numbers of an action), n >= 1, in the units of `robogauntlet.adapters.contract`."""
    routing: Routing | None = None


class Policy(Protocol):
    """Acts in any number of episodes at once; an episode's actions depend on that episode alone."""

    spec: PolicySpec

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes. All randomness is keyed by `episode.id`."""

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return a decision for each query, in order."""

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Drop the state of these episodes."""


class StatelessPolicy:
    """Base of policies without state between queries."""

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Do nothing."""

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class PolicyFiles:
    """The files that a policy is built from."""

    options: Mapping[str, Path]
    """Option to its folder or file. With the path of a copy instead, the policy is the same."""
    files: tuple[Path, ...]
    """All files that are read. Their positions relative to each other matter, their location does not."""


@dataclass(frozen=True)
class Contact:
    """What the server of a policy says of itself."""

    options: Mapping[str, Any]
    """The policy's options, with which any process refuses a server that says something else."""
    metadata: str | None = None
    """Hash of what it says, if the policy's own hash does not cover it."""
    warning: str = ""
    """What a reader of its numbers must know, or ""."""


@dataclass(frozen=True)
class PolicyKind:
    """A kind of policy, as its entry point (group `robogauntlet.policies`) declares it. Building one is cheap."""

    name: str
    summary: str
    load: Callable[[Mapping[str, Any]], Policy]
    """Builds the policy from the options that the suite gives."""
    digest: Callable[[Mapping[str, Any]], str]
    """Hash of the policy's content under these options: equal if and only if it acts the same."""
    digest_without_start: Callable[[Mapping[str, Any]], str | None] | None = None
    """For kinds whose options name code or a server: checks the options and returns the digest, without importing or
    contacting anything; None if only the server knows it."""
    tasks: Callable[[], frozenset[str]] | None = None
    """Tasks it can act in (`simulator/task`), or None for all."""
    spec: Callable[[Mapping[str, Any]], PolicySpec] | None = None
    """Returns the policy's spec under these options, faster than loading does or without the GPU that it needs; None to
    load the policy for it."""
    wishes: Callable[[Mapping[str, Any]], Wishes] | None = None
    """Returns what the policy asks of a suite under these options, without importing or contacting anything."""
    contact: Callable[[Mapping[str, Any]], Contact] | None = None
    """For kinds behind a server: asks it what it is. Raises PolicyUnreachable."""
    imports_code: bool = False
    """Whether its options name code of the user, which a plan imports in a process of its own."""
    address: str = ""
    """For kinds behind a server: the form of its address, such as `openpi://HOST:PORT`."""
    needs: str = ""
    """What it needs besides its address, or ""."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Option name to its meaning. Other options in a suite are errors."""
    modules: tuple[str, ...] = ()
    """Import names that must be installed in the policy's environment."""
    distributions: tuple[str, ...] = ()
    """Distributions whose versions belong to the provenance of a result."""
    requirements: tuple[str, ...] = ()
    """pip requirements of a policy that runs in a Python environment of its own (`robogauntlet env create`). Its option
    `python` is then that environment's interpreter."""
    without_dependencies: tuple[str, ...] = ()
    """Further requirements, which are installed without their dependencies."""
    preferred: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Version of Python, such as `3.12`, to the requirements of an environment that is made instead where one is at
    hand, and inherits nothing."""
    imports: str = ""
    """`MODULE:FUNCTION` that imports what the policy needs; `robogauntlet env list` calls it in its environment."""
    files: Callable[[Mapping[str, Any]], PolicyFiles] | None = None
    """Returns the policy's files under these options, for cluster nodes that lack them; None if it needs none."""
    named: Callable[[str], Mapping[str, Any] | None] | None = None
    """Returns the options of the policy that a text names (a folder, `zoo:NAME`), or None if it names none of this
    kind. Raises PolicyError for a text that can only be meant for it and is wrong."""
    digest_in: Callable[[Mapping[str, Any], str], str] | None = None
    """Hash of what acts in one task (`simulator/task`), for policies of a part per task; None for that of the whole."""
    no_skill: bool = False
    """Whether its success rates show what chance achieves."""


def check_tasks(spec: PolicySpec, tasks: Sequence[str]) -> None:
    """Refuse a policy that cannot act in one of the tasks.

    Raises:
        PolicyMismatch: It cannot; the message names the tasks in which it can, or the numbers that one accepts.
    """
    for task in tasks:
        if misfit := spec.misfit(body_of(task)):
            raise PolicyMismatch(f"{task} {misfit}")
    if beyond := [task for task in tasks if not spec.can_act_in(task)]:
        able = first_of(sorted(spec.tasks or ()), SHOWN_TASKS)
        raise PolicyMismatch(f"it cannot act in {first_of(beyond, SHOWN_TASKS)}; it can in {able}")


def check_fit(spec: PolicySpec, action_spec: ActionSpec, observation_spec: ObservationSpec) -> None:
    """Refuse a policy that does not fit a simulation.

    Raises:
        PolicyMismatch: The policy does not fit.
    """
    if misfit := spec.misfit(action_spec.body):
        raise PolicyMismatch(f"the simulation {misfit}")
    if spec.sees is PolicyInput.OBSERVATION:
        missing = [camera for camera in spec.cameras if camera not in observation_spec.cameras]
        if missing:
            raise PolicyMismatch(
                f"the policy needs camera {missing[0]}, the suite renders {', '.join(observation_spec.cameras)}"
            )
        if spec.image_size not in (None, observation_spec.image_size):
            sizes = f"{spec.image_size} px images, the suite renders {observation_spec.image_size} px"
            raise PolicyMismatch(f"the policy was made for {sizes}")


def check_routing(routing: Routing) -> Routing:
    """Return a policy's routing evidence in Python's own types, scores rounded to 1e-6 so that records compare equal.

    Raises:
        PolicyMismatch: A score is NaN or infinite, the choice has no score, the latency is negative, or there are more
            than `MOST_SCORES` scores, or names of more than `LONGEST_NAME` characters.
    """
    if len(routing.scores) > MOST_SCORES:
        raise PolicyMismatch(f"expected at most {MOST_SCORES:,} scores of the router, got {len(routing.scores):,}")
    if (longest := max(map(len, map(str, (*routing.scores, routing.choice))))) > LONGEST_NAME:
        raise PolicyMismatch(f"expected the router's names of at most {LONGEST_NAME} characters, got {longest:,}")
    scores = {str(name): _rounded(score, f"score of {name}") for name, score in routing.scores.items()}
    if scores and routing.choice not in scores:
        raise PolicyMismatch(f"expected the router's choice among {', '.join(sorted(scores))}; got {routing.choice}")
    latency_s = _rounded(routing.latency_s, "latency")
    if latency_s < 0:
        raise PolicyMismatch(f"expected a routing latency of 0 s or more, got {latency_s}")
    unknown = None if routing.unknown is None else _rounded(routing.unknown, "score for an unknown task")
    rejected = None if routing.rejected is None else bool(routing.rejected)
    return Routing(scores, str(routing.choice), float(routing.latency_s), unknown, rejected)


def _rounded(value: float, what: str) -> float:
    number = float(value)
    if not np.isfinite(number):
        raise PolicyMismatch(f"expected a finite number as the router's {what}, got {number}")
    return round(number, 6) + 0.0  # no -0.0, which is written differently


def check_chunk(actions: FloatArray, numbers: int = ACTION_DIM) -> FloatArray:
    """Return a policy's chunk as a new float64 array, shape (n, numbers).

    Raises:
        PolicyMismatch: It has another shape, is empty, or holds NaN or infinity.
    """
    chunk = chunk_of(actions, numbers)
    if not np.isfinite(chunk).all():
        raise PolicyMismatch(f"expected finite actions, got {chunk[~np.isfinite(chunk)][0]} in the chunk")
    return chunk


def chunk_of(actions: Any, numbers: int = ACTION_DIM) -> FloatArray:
    """Return what a policy answered as a new float64 array, shape (n, numbers), which may hold NaN.

    Raises:
        PolicyMismatch: It is no array of numbers, has another shape, or is empty.
    """
    if actions is None:
        raise PolicyMismatch(f"expected an action chunk, shape (n, {numbers}); got None: a return is missing")
    try:
        if (given := np.asarray(actions)).dtype.kind not in "biufO":
            raise ValueError(f"its type is {given.dtype}")
        chunk = np.array(actions, dtype=np.float64)
    except Exception as error:  # what is converted may raise anything: torch, an integer without a limit
        raise PolicyMismatch(
            f"expected an action chunk of numbers, shape (n, {numbers}); got {type(actions).__name__}: "
            f"{first_line(error)}"
        ) from None
    if chunk.ndim != 2 or chunk.shape[1] != numbers or len(chunk) == 0:
        raise PolicyMismatch(f"expected an action chunk of shape (n, {numbers}) with n >= 1, got {chunk.shape}")
    return chunk
