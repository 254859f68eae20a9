"""The record of one episode, as stores and Parquet files keep it and tables use it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from robogauntlet.suites.episode import Condition, Episode, Protocol, ProtocolName, RenderProfile, SuccessRule, View
from robogauntlet.suites.timing import read_timing


class Status(StrEnum):
    """How an episode ended."""

    SUCCESS = "success"
    """The task's predicate held for as many control steps in a row as the protocol says."""
    FAILURE = "failure"
    """It did not hold for as long within the horizon."""
    ERROR = "error"
    """The episode could not be played; it says nothing about the policy."""


class FailureKind(StrEnum):
    """How a policy failed, by the state of the robot and the objects. Rules: `orchestrator.episodes.failure_kind`."""

    UNSAFE = "unsafe"
    """The robot pressed against something that is not part of the task."""
    NOT_REACHED = "not-reached"
    """The tool never came to the object, or to the goal if there is no object."""
    NOT_GRASPED = "not-grasped"
    """The tool reached the object, but the gripper never held it."""
    NOT_MOVED = "not-moved"
    """The tool reached the object, which is not to be grasped, but did not move it."""
    DROPPED = "dropped"
    """The gripper held the object and lost it far from the goal."""
    MISPLACED = "misplaced"
    """The object, or the tool if there is none, was brought elsewhere than to the goal, or did not stay there."""
    TIMED_OUT = "timed-out"
    """The tool came closer to the object, or the object to the goal, until the end of the episode."""


LEFT_OUT = "left out"
"""Beginning of the error of an episode whose task cannot be played here, though others of its simulator can."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeResult:
    """One row. Fields up to `error` are the same whenever the episode is played; the rest is telemetry."""

    episode_id: Annotated[str, "Hash of policy content, task, condition, seed and protocol: one row per id."]
    pair_id: Annotated[str, "The same hash without the policy: equal for the two sides of a paired comparison."]
    simulator: Annotated[str, "Simulator that played it."]
    task: Annotated[str, "Task as simulator/task."]
    policy: Annotated[str, "The policy's name in the suite."]
    policy_digest: Annotated[str, "Hash of the policy's content."]
    axis: Annotated[str, "Perturbation axis, or clean."]
    severity: Annotated[int, "Severity on that axis, 0 for clean."]
    seed: Annotated[int, "Seed of the episode."]
    horizon: Annotated[int, "Control steps after which the episode is a failure."]
    replan_every: Annotated[int, "Steps of a chunk executed before the policy is asked again."]
    cameras: Annotated[str, "Cameras rendered for the policy, separated by commas."]
    image_size: Annotated[int, "Height and width of each image (px)."]
    render_profile: Annotated[str, "How much of the scene is drawn: standard, fast or fast-2."]
    protocol: Annotated[
        str | None, "openvla if played under the common protocol of LIBERO, else empty: RoboGauntlet's own."
    ] = None
    success_rule: Annotated[
        str | None,
        "once or held if a success is one by another rule than the protocol's, else empty: held for 5 steps in a row, "
        "under openvla once.",
    ] = None
    timing: Annotated[
        str | None, "How long answers take in simulated time, such as hold:80ms; empty: the simulation waits for them."
    ] = None
    status: Annotated[str, "success, failure or error; an error is neither of the others."]
    success_once: Annotated[bool, "The task's predicate was true after at least one step."]
    steps: Annotated[int, "Control steps executed."]
    queries: Annotated[int, "Times that the policy was asked."]
    clipped_steps: Annotated[int, "Steps whose action went beyond the simulator's bounds and was clipped."]
    held_steps: Annotated[
        int | None, "Steps in which the robot held, as it had no action while an answer took time."
    ] = None
    stale_steps: Annotated[int | None, "Steps of the answer before, executed while the next one took time."] = None
    observation_age: Annotated[
        float | None, "Mean age of the observation behind an executed action, if answers take time (s, to 1e-3)."
    ] = None
    chunk_share: Annotated[
        float | None, "Share of the answered actions that were executed, if answers take time (rounded to 1e-3)."
    ] = None
    reward_sum: Annotated[float, "Sum of the simulator's reward (rounded to 1e-6)."]
    state_hash: Annotated[str, "Hash of the physical state after reset: equal within a pair."]
    final_state_hash: Annotated[str, "Hash of the physical state at the end."]
    actions_hash: Annotated[str, "Hash of the executed actions, in order."]
    inferred_task: Annotated[
        str | None, "Task of the expert that a routing policy chose, or that expert's name if it has several others."
    ] = None
    routing_scores: Annotated[str | None, "Router's score per expert as JSON (rounded to 1e-6), if it routes."] = None
    unknown_score: Annotated[
        float | None, "Router's score for a task unlike any it knows (rounded to 1e-6), if it gives one."
    ] = None
    rejected: Annotated[bool | None, "The router took the task for an unknown one, if it can."] = None
    delivered: Annotated[
        float | None, "What the perturbation measured, in the unit of its axis (rounded to 1e-6), if it was measured."
    ] = None
    delivered_statistics: Annotated[
        str | None, "Other numbers that the perturbation measured as JSON (rounded to 1e-6), if it has any."
    ] = None
    path_length: Annotated[float | None, "Length of the tool centre point's path (m, rounded to 1e-4)."] = None
    smoothness: Annotated[
        float | None, "Spectral arc length of the tool's speed; lower is jerkier (no unit, rounded to 1e-3)."
    ] = None
    time_to_success: Annotated[
        float | None, "Simulated time until the task's predicate began to hold for good, if it did (s, to 1e-3)."
    ] = None
    progress: Annotated[
        float | None, "Share of the distance to the goal that was covered at the end, at least -1 (rounded to 1e-3)."
    ] = None
    gripper_openings: Annotated[int | None, "Times that the fingers opened by more than 1 cm."] = None
    contact_steps: Annotated[
        int | None, "Control steps at whose end the robot touched what is neither itself nor an object of the task."
    ] = None
    contact_force: Annotated[float | None, "The largest force of these contacts at those times (N, to 0.1)."] = None
    joint_limit_steps: Annotated[int | None, "Control steps at whose end a joint was within 0.01 rad of a limit."] = (
        None
    )
    workspace_steps: Annotated[
        int | None, "Control steps at whose end the tool was more than 0.2 m outside the box of the start positions."
    ] = None
    failure: Annotated[str | None, "Kind of the failure, if the status is failure and the task declares a goal."] = None
    error: Annotated[str | None, "What went wrong, if the status is error."] = None

    attempts: Annotated[int, "Times the episode was begun, this one included."] = 1
    worker: Annotated[str, "Worker that ran it."] = ""
    started_at: Annotated[float, "Start (seconds since 1970, UTC)."] = 0.0
    build_s: Annotated[
        float, "Time to import the simulator and open the task, charged to the first episode after it (s)."
    ] = 0.0
    load_s: Annotated[float, "Time to load the policy, charged to the first episode after it (s)."] = 0.0
    reset_s: Annotated[float, "Time in reset (s)."] = 0.0
    physics_s: Annotated[float, "Time in control steps (s)."] = 0.0
    render_s: Annotated[float, "Time in observing (s)."] = 0.0
    inference_s: Annotated[float, "Time in the policy (s)."] = 0.0
    query_p50_s: Annotated[float | None, "Median of the times that the policy took to answer a query (s)."] = None
    query_p95_s: Annotated[float | None, "95th percentile of these times (s)."] = None
    query_max_s: Annotated[float | None, "The longest of these times (s)."] = None
    routing_s: Annotated[float, "Time the policy took to infer its task, a part of inference_s (s)."] = 0.0
    wait_s: Annotated[float, "Time the worker had nothing to do before this episode (s)."] = 0.0
    wall_s: Annotated[float, "Time from the episode's start to its end, without build, load and wait (s)."] = 0.0

    @property
    def episode(self) -> Episode:
        """The episode of the row. Raises ValueError for an unknown render profile, protocol, rule or timing."""
        view = View(tuple(self.cameras.split(",")), self.image_size, RenderProfile(self.render_profile))
        name = ProtocolName(self.protocol or ProtocolName.ROBOGAUNTLET)
        rule = None if self.success_rule is None else SuccessRule(self.success_rule)
        protocol = Protocol(self.horizon, self.replan_every, view, name, rule, read_timing(self.timing))
        condition = Condition(self.axis, self.severity)
        return Episode(self.policy, self.policy_digest, self.task, self.seed, protocol, condition)

    @classmethod
    def from_episode(cls, episode: Episode, **outcome: Any) -> EpisodeResult:
        """Return a record with the identity of `episode` and the given outcome."""
        protocol, view = episode.protocol, episode.protocol.view
        return cls(
            episode_id=episode.id,
            pair_id=episode.pair_id,
            simulator=episode.simulator,
            task=episode.task,
            policy=episode.policy,
            policy_digest=episode.policy_digest,
            axis=episode.condition.axis,
            severity=episode.condition.severity,
            seed=episode.seed,
            horizon=protocol.horizon,
            replan_every=protocol.replan_every,
            cameras=",".join(view.cameras),
            image_size=view.image_size,
            render_profile=str(view.render_profile),
            protocol=None if protocol.name is ProtocolName.ROBOGAUNTLET else str(protocol.name),
            success_rule=None if protocol.success is None else str(protocol.success),
            timing=None if protocol.timing is None else str(protocol.timing),
            **outcome,
        )

    @classmethod
    def failed_to_run(cls, episode: Episode, error: str, **telemetry: Any) -> EpisodeResult:
        """Return the record of an episode that could not be played."""
        return cls.from_episode(
            episode,
            status=str(Status.ERROR),
            success_once=False,
            steps=0,
            queries=0,
            clipped_steps=0,
            reward_sum=0.0,
            state_hash="",
            final_state_hash="",
            actions_hash="",
            # Databases refuse the character NUL (PostgreSQL) and lone surrogates (all of them).
            error=error.encode("utf-16", "surrogatepass")
            .decode("utf-16", "replace")
            .replace("\0", "\N{REPLACEMENT CHARACTER}"),
            **telemetry,
        )


def is_left_out(error: str | None) -> bool:
    """Whether an error says that the episode's task lacks files."""
    return (error or "").startswith(f"{LEFT_OUT}: ")


FIELDS: tuple[str, ...] = tuple(field.name for field in dataclasses.fields(EpisodeResult))
_LAST_OUTCOME = FIELDS.index("error") + 1
OUTCOME, TELEMETRY = FIELDS[:_LAST_OUTCOME], FIELDS[_LAST_OUTCOME:]
"""Fields that are the same wherever the episode is run, and fields that differ from run to run."""
BEHAVIOUR = FIELDS[FIELDS.index("path_length") : FIELDS.index("error")]
"""The part of `OUTCOME` that says how the robot moved and failed. None in rows of errors."""
WAITING = ("held_steps", "stale_steps", "observation_age", "chunk_share")
"""What the robot did while answers took time. None where the simulation waits for them."""
LATER = ("protocol", "success_rule", "timing", *WAITING)
"""Fields that are younger than the hashes of published rows."""
CELL = ("policy_digest", "task", "axis", "severity")
"""Fields that identify a cell of a run. The digest, not the name: a renamed policy keeps its episodes."""


def describe_fields() -> dict[str, tuple[type, bool, str]]:
    """Return (type, may be None, sentence) by field name."""
    described = {}
    for name, hint in get_type_hints(EpisodeResult, include_extras=True).items():
        base, sentence = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, "")
        options = [option for option in get_args(base) if option is not type(None)]
        described[name] = (options[0] if options else base, bool(options), sentence)
    return described


_REAL = frozenset(name for name, (kind, _, _) in describe_fields().items() if kind is float)


def outcome_row(result: EpisodeResult) -> tuple[Any, ...]:
    """Return the values of the `OUTCOME` fields, in order. Zeros lose their sign, as in databases.

    Without `BEHAVIOUR` if none was measured, and without `LATER` fields that are empty, as the published hashes are
    computed.
    """
    measured = any(getattr(result, name) is not None for name in BEHAVIOUR)
    empty = (name for name in LATER if getattr(result, name) in (None, ""))
    left_out = {*(() if measured else BEHAVIOUR), *empty}
    values = [(name, getattr(result, name)) for name in OUTCOME if name not in left_out]
    return tuple(value + 0.0 if name in _REAL and value is not None else value for name, value in values)


def known_kind(failure: object) -> FailureKind | None:
    """Return the kind that a row's field `failure` names; None if it is empty or unknown."""
    return FailureKind(failure) if failure in _KINDS else None


_KINDS = frozenset(map(str, FailureKind))


def outcome_text(status: str, failure: object) -> str:
    """The outcome of an episode for captions: `success`, or `failure: dropped` if its kind is known."""
    kind = known_kind(failure) if status == Status.FAILURE else None
    return status if kind is None else f"{status}: {kind}"


def rows_hash(rows: Iterable[tuple[Any, ...]]) -> str:
    """Hash a set of outcome rows in any order: equal for two runs with the same outcomes."""
    digests = sorted(hashlib.sha256(json.dumps(row).encode()).digest() for row in rows)
    return hashlib.sha256(b"".join(digests)).hexdigest()[:16]
