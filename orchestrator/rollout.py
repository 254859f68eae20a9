"""One episode, from reset to verdict. No Ray, no files: everything else is built around this function."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from adapters.contract import ACTION_NAMES, AdapterError, Simulation
from adapters.frames import STATE_QUANTUM
from orchestrator.perturbations import perturbed
from orchestrator.perturbations.base import Perturbed
from orchestrator.perturbations.references import ReferenceLooks
from policies.contract import Decision, Policy, PolicyError, Query, Routing, Sees, check_chunk, check_routing
from results.record import EpisodeResult, Status
from suites.vocabulary import SUCCESS_HOLD, Episode

Watcher = Callable[[Simulation, int], None]
"""Called after reset and after every control step with the number of steps taken: for videos and recordings."""


class _Timed:
    """Adds the duration of a block to a phase. A class, since a generator costs four times as much at each step."""

    __slots__ = ("_clock", "_phase", "_seconds", "_start")

    def __init__(self, seconds: dict[str, float], phase: str, clock: Callable[[], float]) -> None:
        self._seconds, self._phase, self._clock = seconds, phase, clock

    def __enter__(self) -> None:
        self._start = self._clock()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self._seconds[self._phase] += self._clock() - self._start


@dataclass
class Phases:
    """Seconds spent in each phase of an episode."""

    seconds: dict[str, float] = field(
        default_factory=lambda: dict.fromkeys(("reset", "physics", "render", "inference"), 0.0)
    )
    clock: Callable[[], float] = time.perf_counter

    def timed(self, phase: str) -> _Timed:
        """Add the duration of a `with` block to `phase`."""
        return _Timed(self.seconds, phase, self.clock)

    def as_fields(self) -> dict[str, float]:
        """As fields of an `EpisodeResult`."""
        return {f"{phase}_s": seconds for phase, seconds in self.seconds.items()}


def rollout(
    simulation: Simulation,
    policy: Policy,
    episode: Episode,
    *,
    eager: bool = False,
    watcher: Watcher | None = None,
    references: ReferenceLooks | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> EpisodeResult:
    """Play one episode.

    The policy is asked when its chunk is used up or `replan_every` steps of it are executed, and only then is anything
    rendered. The episode succeeds, and ends, once the task's predicate has held for `SUCCESS_HOLD` steps in a row; it
    fails at the horizon.

    Args:
        simulation: The open task that the episode names.
        policy: Acts; `check_fit` has accepted it.
        episode: What to play.
        eager: Also render after every step that the policy does not look at (as a plain environment loop does). Changes
            nothing but the time it takes.
        watcher: See `Watcher`.
        references: Looks that were kept of this simulation's task; they change nothing but the time it takes.
        clock: Seconds, from anywhere; stands still while the episode is set aside for others (`lockstep`).

    Returns:
        The episode's record, without the fields that only a worker knows.

    Raises:
        PolicyError: The policy's answer does not fit.
        AdapterError: The simulator's rewards are not finite, or a perturbation was not delivered.
        Exception: Whatever the simulator or the policy raises.
    """
    started, began = time.time(), clock()
    phases = Phases(clock=clock)
    world, simulation = simulation, perturbed(simulation, episode, references)
    with phases.timed("reset"):
        simulation.reset(episode.seed, episode.condition)
    with phases.timed("inference"):
        policy.reset([episode])
    if isinstance(simulation, Perturbed):
        simulation.check_start()
    state_hash = simulation.state_hash()
    spec, protocol = simulation.action_spec, episode.protocol
    low, high = spec.low, spec.high
    ignored = [ACTION_NAMES.index(name) for name in spec.ignored]

    actions = hashlib.sha256()
    routing: Routing | None = None
    answer_times: list[float] = []
    steps = held = clipped = 0
    success_once = terminated = False
    reward = 0.0
    if watcher:
        watcher(simulation, steps)
    while steps < protocol.horizon and held < SUCCESS_HOLD and not terminated:
        query = _look(simulation, policy, episode, steps, phases)
        if isinstance(simulation, Perturbed) and query.observation is not None:
            simulation.check_words(query.observation.instruction)
        asked = clock()
        with phases.timed("inference"):
            decision = _ask(policy, query)
            chunk = check_chunk(decision.actions)
        answer_times.append(clock() - asked)
        if routing is None and decision.routing is not None:
            routing = check_routing(decision.routing)
        chunk = chunk[: min(protocol.replan_every, protocol.horizon - steps)]
        chunk[:, ignored] = 0.0
        fitting = np.clip(chunk, low, high)
        beyond = (np.abs(fitting - chunk) > 1e-9).any(axis=1).tolist()
        quantised = (np.round(fitting / STATE_QUANTUM) + 0.0).astype("<f8")
        for action, row, too_far in zip(fitting, quantised, beyond, strict=True):
            actions.update(row.data)
            clipped += too_far
            with phases.timed("physics"):
                outcome = simulation.step(action)
            steps += 1
            reward += outcome.reward
            held = held + 1 if outcome.success else 0
            success_once |= outcome.success
            terminated = outcome.terminated
            if watcher:
                watcher(simulation, steps)
            if held >= SUCCESS_HOLD or terminated:
                break
            if eager:
                with phases.timed("render"):
                    world.observe()
    policy.finish([episode])
    delivered = simulation.delivered() if isinstance(simulation, Perturbed) else None
    if not math.isfinite(reward):
        raise AdapterError(f"the simulator's rewards add up to {reward}, expected a finite number")
    return EpisodeResult.of(
        episode,
        status=str(Status.SUCCESS if held >= SUCCESS_HOLD else Status.FAILURE),
        success_once=success_once,
        steps=steps,
        queries=len(answer_times),
        **_query_times(answer_times),
        clipped_steps=clipped,
        reward_sum=round(reward, 6),
        state_hash=state_hash,
        final_state_hash=simulation.state_hash(),
        actions_hash=actions.hexdigest()[:16],
        inferred_task=routing.choice if routing else None,
        routing_scores=json.dumps(dict(routing.scores), sort_keys=True) if routing else None,
        unknown_score=routing.unknown if routing else None,
        rejected=routing.rejected if routing else None,
        delivered=_rounded(delivered.value) if delivered and delivered.value is not None else None,
        delivered_statistics=_statistics_text(delivered.statistics) if delivered and delivered.statistics else None,
        routing_s=routing.latency_s if routing else 0.0,
        started_at=started,
        wall_s=clock() - began,
        **phases.as_fields(),
    )


def _query_times(seconds: list[float]) -> dict[str, float]:
    """Median, 95th percentile and longest of the answers' times, as fields of an `EpisodeResult`; by nearest rank."""
    ranked = sorted(seconds)
    last = len(ranked) - 1
    places = {"query_p50_s": 0.5, "query_p95_s": 0.95, "query_max_s": 1.0}
    return {name: ranked[round(place * last)] for name, place in places.items()} if ranked else {}


def _rounded(value: float) -> float:
    return round(value, 6)


def _statistics_text(statistics: Mapping[str, float]) -> str:
    """As JSON, which has no infinity: a number that is none is null."""
    plain = {name: _rounded(value) if math.isfinite(value) else None for name, value in statistics.items()}
    return json.dumps(plain, sort_keys=True)


def _look(simulation: Simulation, policy: Policy, episode: Episode, step: int, phases: Phases) -> Query:
    match policy.spec.sees:
        case Sees.OBSERVATION:
            with phases.timed("render"):
                return Query(episode, step, observation=simulation.observe())
        case Sees.PRIVILEGED_STATE:
            with phases.timed("physics"):
                return Query(episode, step, privileged_state=simulation.privileged_state())
        case Sees.NOTHING:
            return Query(episode, step)


def _ask(policy: Policy, query: Query) -> Decision:
    decisions = policy.act([query])
    if len(decisions) != 1 or not isinstance(decisions[0], Decision):
        raise PolicyError(f"expected one Decision for one query, got {len(decisions)} answers")
    return decisions[0]
