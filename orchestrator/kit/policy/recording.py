"""Plays a policy and keeps what it was asked, what it answered, and how long that took."""

from __future__ import annotations

import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, replace
from types import FrameType
from typing import TypeVar

import numpy as np

from robogauntlet.adapters.contract import FloatArray, Moves, Observation, Simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import Decision, Policy, PolicyError, PolicyInput, Query, check_chunk
from robogauntlet.results.record import Status
from robogauntlet.suites.episode import Episode
from robogauntlet.support.errors import describe

LIMIT_S = 60.0
"""Time for one answer (s)."""
Result = TypeVar("Result")


class InvalidAnswer(PolicyError):
    """The policy raised, or its answer is not an action chunk."""


@dataclass(frozen=True)
class Answer:
    """A policy's answer to one query."""

    query: Query
    chunk: FloatArray
    """Shape (n, numbers of an action)."""
    seconds: float


@dataclass(frozen=True)
class Play:
    """One episode as it was played."""

    episode: Episode
    answers: Sequence[Answer]
    tool: FloatArray
    """Positions of the tool after each step, beginning with the reset, shape (steps + 1, 3), m; 0 without a tool."""
    distances: dict[str, FloatArray]
    """Name of an object or goal to its distance from the tool, shape (steps + 1,), m."""
    joint_angles: FloatArray
    """Of an arm with targets of joints at the reset, shape (joints,), rad; of others (0,)."""
    success: bool

    def actions(self) -> FloatArray:
        """Return the actions that were executed, unclipped, shape (steps, numbers of an action)."""
        steps, chunks = len(self.tool) - 1, []
        for answer, end in zip(self.answers, [*(a.query.step for a in self.answers[1:]), steps], strict=True):
            chunks.append(answer.chunk[: end - answer.query.step])
        return np.concatenate(chunks)

    def offsets(self) -> FloatArray:
        """Return `actions`, targets of joints as differences from where the joints start (rad)."""
        return self.actions() - (np.append(self.joint_angles, 0.0) if len(self.joint_angles) else 0.0)


class RecordingPolicy:
    """Forwards to a policy and keeps its answers."""

    def __init__(self, policy: Policy) -> None:
        self.spec, self._policy = policy.spec, policy
        self.answers: list[Answer] = []

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes. Raises InvalidAnswer if the policy raises."""
        _called("reset", lambda: self._policy.reset(episodes))

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Ask the policy. Raises InvalidAnswer if it raises or its answer is not a chunk."""
        asked = deepcopy(list(queries))  # a policy may change what it is given
        start = time.perf_counter()
        with _limited(LIMIT_S):
            decisions = _called("the policy", lambda: self._policy.act(queries))
        seconds = time.perf_counter() - start
        answered = [(decision.actions, query.action_dim) for decision, query in zip(decisions, asked, strict=False)]
        chunks = _called("the answer", lambda: [check_chunk(*pair) for pair in answered])
        self.answers += [Answer(*pair, seconds) for pair in zip(asked, chunks, strict=False)]
        return decisions

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Drop these episodes."""
        self._policy.finish(episodes)


class _Late(Exception):
    """The time for an answer is over."""


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Raise _Late in the block after this time (s), in this thread, since a policy may be bound to it.

    Only the main thread has such an alarm; elsewhere there is no limit.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ring(number: int, frame: FrameType | None) -> None:
        raise _Late

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _called(what: str, call: Callable[[], Result]) -> Result:
    try:
        return call()
    except PolicyError as error:
        raise InvalidAnswer(str(error)) from None
    except _Late:
        raise InvalidAnswer(f"expected an answer within {LIMIT_S:g} s, got none; find out where {what} hangs") from None
    except (Exception, SystemExit, KeyboardInterrupt) as error:  # a policy may raise anything
        frame = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{os.path.basename(frame.filename)}:{frame.lineno}"  # noqa: PTH119
        raise InvalidAnswer(f"{what} raised {describe(error)} [{place}]") from None


def play(simulation: Simulation, policy: Policy, episode: Episode) -> Play:
    """Play an episode.

    Raises:
        InvalidAnswer: The policy raised, or its answer is not an action chunk.
        AdapterError: The simulator does not work.
    """
    recording = RecordingPolicy(policy)
    tool: list[FloatArray] = []
    distances: dict[str, list[float]] = {}
    start = np.zeros(0)

    def watch(simulation: Simulation, step: int) -> None:
        nonlocal start
        state = simulation.privileged_state()
        if simulation.action_spec.numbers:
            tool.append(np.zeros(3))
            return
        tool.append(state["tcp_position"])
        if step == 0 and simulation.action_spec.body.moves is Moves.TARGETS:
            start = state["joint_angles"]
        for name, value in state.items():
            if name.endswith("_position") and name != "tcp_position" and np.shape(value) == (3,):
                distances.setdefault(name.removesuffix("_position"), []).append(
                    float(np.linalg.norm(value - state["tcp_position"]))
                )

    try:
        result = rollout(simulation, recording, episode, watcher=watch)
    except InvalidAnswer:
        policy.finish([episode])
        raise
    found = {name: np.array(values) for name, values in distances.items()}
    return Play(episode, tuple(recording.answers), np.array(tool), found, start, result.status == Status.SUCCESS)


def ask_again(
    policy: Policy, answers: Sequence[Answer], change: Callable[[Observation], Observation]
) -> list[FloatArray]:
    """Ask the first queries of an episode again, from its reset on, with changed observations; return the chunks.

    Raises:
        InvalidAnswer: See `play`.
    """
    assert policy.spec.sees is PolicyInput.OBSERVATION
    recording, episodes = RecordingPolicy(policy), [answers[0].query.episode]
    recording.reset(episodes)
    try:
        for answer in answers:
            assert answer.query.observation is not None
            recording.act([replace(answer.query, observation=change(deepcopy(answer.query.observation)))])
    finally:
        recording.finish(episodes)
    return [answer.chunk for answer in recording.answers]
