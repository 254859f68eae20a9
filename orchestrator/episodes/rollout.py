"""One episode, from reset to outcome. No Ray, no files: everything else is built around this function."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from robogauntlet.adapters.catalog import goal_of
from robogauntlet.adapters.contract import (
    PENDING,
    AdapterError,
    Delivered,
    FloatArray,
    Measured,
    Simulation,
    StepOutcome,
)
from robogauntlet.adapters.frames import STATE_QUANTUM
from robogauntlet.adapters.motion import holding, standing_still
from robogauntlet.orchestrator.episodes.behaviour import BehaviourMeter
from robogauntlet.orchestrator.episodes.timeline import Timeline
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import PerturbedSimulation, ReferenceImages
from robogauntlet.policies.contract import (
    Decision,
    Policy,
    PolicyError,
    PolicyInput,
    Query,
    Routing,
    check_chunk,
    check_routing,
)
from robogauntlet.results.record import EpisodeResult, Status
from robogauntlet.suites.episode import Episode
from robogauntlet.support.text import counted

Watcher = Callable[[Simulation, int], None]
"""Called after reset and after every control step with the number of steps taken; records videos and trajectories."""
Clock = Callable[[], float]
"""Returns a time (s)."""


class _Timed:
    """Adds the duration of a block (s). A class, because a generator costs four times as much at each step."""

    __slots__ = ("_clock", "_field", "_seconds", "_start")

    def __init__(self, seconds: dict[str, float], clock: Clock, field: str) -> None:
        self._seconds, self._clock, self._field = seconds, clock, field

    def __enter__(self) -> None:
        self._start = self._clock()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self._seconds[self._field] += self._clock() - self._start


def rollout(
    simulation: Simulation,
    policy: Policy,
    episode: Episode,
    *,
    eager: bool = False,
    watcher: Watcher | None = None,
    references: ReferenceImages | None = None,
    clock: Clock = time.perf_counter,
) -> EpisodeResult:
    """Play one episode.

    The policy is queried when its chunk is used up or `replan_every` steps of it are executed; images are rendered only
    then. While an answer takes simulated time, the robot does what the protocol's timing says, see `Timeline`. The
    episode succeeds and ends when the task's success predicate has held for as many steps in a row as the protocol
    says; it fails at the horizon.

    Args:
        simulation: The episode's task, open.
        policy: A policy that `check_fit` has accepted.
        episode: The episode to play.
        eager: Also render after steps that the policy does not observe, as a plain environment loop does. Affects
            only the duration.
        watcher: See `Watcher`.
        references: Cached reference images of this simulation's task. They affect only the duration.
        clock: Measures the durations in the record.

    Returns:
        The episode's record, without the fields that a worker fills in.

    Raises:
        PolicyError: The policy's answer is invalid.
        AdapterError: The simulator's rewards are not finite, or a perturbation was not delivered.
        Exception: Whatever the simulator or the policy raises.
    """
    playing = played(simulation, policy, episode, eager=eager, watcher=watcher, references=references, clock=clock)
    decision: Decision | None = None
    while True:
        try:
            query = playing.send(decision)
        except StopIteration as ended:
            row: EpisodeResult = ended.value
            return row
        assert isinstance(query, Query)  # only worlds of a batch have steps that are pending
        (decision,) = ask(policy, [query])


def played(
    simulation: Simulation,
    policy: Policy,
    episode: Episode,
    *,
    eager: bool = False,
    watcher: Watcher | None = None,
    references: ReferenceImages | None = None,
    clock: Clock = time.perf_counter,
) -> Generator[Query | StepOutcome, Any, EpisodeResult]:
    """Play one episode as `rollout` does, but be sent what it waits for.

    Yields:
        Each query, to be sent the policy's decision. In a world of a `BatchSimulation` also `PENDING` after each step,
        to be sent the outcome.
    """
    started, began = time.time(), clock()
    seconds = dict.fromkeys(("reset_s", "physics_s", "render_s", "inference_s"), 0.0)
    timed = partial(_Timed, seconds, clock)
    clean_simulation, simulation = simulation, perturbed(simulation, episode, references)
    meter = BehaviourMeter(clean_simulation, goal_of(episode.task))
    with timed("reset_s"):
        simulation.reset(episode.seed)
    with timed("inference_s"):
        policy.reset([episode])
    if isinstance(simulation, PerturbedSimulation):
        simulation.check_start()
    state_hash = simulation.state_hash()
    meter.sample()
    spec, protocol = simulation.action_spec, episode.protocol
    low, high = spec.low, spec.high
    ignored, numbers = spec.ignored_indices, len(low)
    timeline = Timeline(episode, spec)

    last: FloatArray | None = None
    actions = hashlib.sha256()
    routing: Routing | None = None
    answer_times: list[float] = []
    steps = held = clipped = 0
    success_once = terminated = False
    reward = 0.0
    if watcher:
        watcher(simulation, steps)
    while steps < protocol.horizon and held < protocol.success_hold and not terminated:
        query = _observe(simulation, policy, episode, steps, timed)
        if isinstance(simulation, PerturbedSimulation) and query.observation is not None:
            simulation.check_instruction(query.observation.instruction)
        asked = clock()
        with timed("inference_s"):
            decision = yield query
            chunk = check_chunk(decision.actions, numbers)
        answer_times.append(clock() - asked)
        if routing is None and decision.routing is not None:
            routing = check_routing(decision.routing)
        chunk[:, ignored] = 0.0
        segment, before = timeline.segment(chunk), steps
        planned = segment.actions[: protocol.horizon - steps]
        fitting = np.clip(planned, low, high)
        beyond = (np.abs(fitting - planned) > 1e-9).any(axis=1).tolist()
        quantised = _quantised(fitting)
        for action, row, too_far, held_still in zip(fitting, quantised, beyond, segment.held, strict=False):
            if held_still:
                action[:] = np.clip(holding(simulation, last), low, high)
                row[:], too_far = _quantised(action), False
            last = action
            actions.update(row.data)
            clipped += too_far
            with timed("physics_s"):
                outcome = simulation.step(action)
                if outcome is PENDING:
                    outcome = yield outcome
            steps += 1
            meter.sample()
            reward += outcome.reward
            held = held + 1 if outcome.success else 0
            success_once |= outcome.success
            terminated = outcome.terminated
            if watcher:
                watcher(simulation, steps)
            if held >= protocol.success_hold or terminated:
                break
            if eager:
                with timed("render_s"):
                    clean_simulation.observe()
        timeline.count(segment, steps - before)
    policy.finish([episode])
    delivered = simulation.delivered() if isinstance(simulation, Measured) else Delivered(None)
    if not math.isfinite(reward):
        raise AdapterError(f"the simulator's rewards add up to {reward}, expected a finite number")
    succeeded = held >= protocol.success_hold or (terminated and held > 0)  # What ends in success cannot hold longer.
    status = Status.SUCCESS if succeeded else Status.FAILURE
    return EpisodeResult.from_episode(
        episode,
        status=str(status),
        success_once=success_once,
        steps=steps,
        queries=len(answer_times),
        **_query_times(answer_times),
        clipped_steps=clipped,
        **timeline.columns(),
        reward_sum=round(reward, 6),
        state_hash=state_hash,
        final_state_hash=simulation.state_hash(),
        actions_hash=actions.hexdigest()[:16],
        **(routing_fields(routing) if routing else {}),
        delivered=None if delivered.value is None else round(delivered.value, 6),
        delivered_statistics=_statistics_text(delivered.statistics) if delivered.statistics else None,
        **meter.columns(status, held),
        started_at=started,
        wall_s=clock() - began,
        **seconds,
    )


def _quantised(actions: FloatArray) -> FloatArray:
    """Actions as their hash takes them."""
    return (np.round(actions / STATE_QUANTUM) + 0.0).astype("<f8")


def routing_fields(routing: Routing) -> dict[str, Any]:
    """The fields of an `EpisodeResult` that hold a router's answer."""
    return {
        "inferred_task": routing.choice,
        "routing_scores": json.dumps(dict(routing.scores), sort_keys=True),
        "unknown_score": routing.unknown,
        "rejected": routing.rejected,
        "routing_s": routing.latency_s,
    }


def _query_times(seconds: list[float]) -> dict[str, float]:
    """Median, 95th percentile and maximum of the answer times by nearest rank, as fields of an `EpisodeResult`."""
    ranked = sorted(seconds)
    last = len(ranked) - 1
    places = {"query_p50_s": 0.5, "query_p95_s": 0.95, "query_max_s": 1.0}
    return {name: ranked[round(place * last)] for name, place in places.items()} if ranked else {}


def _statistics_text(statistics: Mapping[str, float]) -> str:
    """JSON text, with null for numbers that are not finite."""
    plain = {name: round(value, 6) if math.isfinite(value) else None for name, value in statistics.items()}
    return json.dumps(plain, sort_keys=True)


def _observe(
    simulation: Simulation, policy: Policy, episode: Episode, step: int, timed: Callable[[str], _Timed]
) -> Query:
    spec = simulation.action_spec
    match policy.spec.sees:
        case PolicyInput.OBSERVATION:
            with timed("render_s"):
                observation = simulation.observe()
                if episode.protocol.mirrored:
                    images = {name: image[:, ::-1].copy() for name, image in observation.images.items()}
                    observation = replace(observation, images=images)
                return Query(episode, step, observation=observation, action_spec=spec)
        case PolicyInput.PRIVILEGED_STATE:
            with timed("physics_s"):
                return Query(episode, step, privileged_state=simulation.privileged_state(), action_spec=spec)
        case PolicyInput.NOTHING:
            return Query(episode, step, action_spec=spec, still=standing_still(simulation))


def ask(policy: Policy, queries: Sequence[Query]) -> Sequence[Decision]:
    """The policy's decisions, one for each query. Raises PolicyError."""
    decisions = policy.act(queries)
    if len(decisions) != len(queries) or not all(isinstance(one, Decision) for one in decisions):
        raise PolicyError(
            f"expected one Decision for {counted(len(queries), 'query', 'queries')}, got {len(decisions)} answers"
        )
    return decisions
