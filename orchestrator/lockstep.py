"""Plays several episodes at once in one process, whose steps, looks and questions are done together.

Each episode is a `rollout` of its own, written as if it were alone, in a greenlet: where it wants a step, a look or an
answer, it is set aside until all others have come as far. So steps of simulations that share an engine are one call of
the engine, and there is only one account of what an episode is.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any

from greenlet import greenlet

from adapters.contract import FloatArray, Observation, Simulation, SimulationBatch, StepOutcome
from orchestrator.around import Around
from policies.contract import Decision, Policy, Query
from results.record import EpisodeResult
from suites.vocabulary import Episode


class _Wish(Enum):
    LOOK = "look"
    ANSWER = "answer"
    STEP = "step"


Play = Callable[[Simulation, Policy, Episode, Callable[[], float]], EpisodeResult]
"""Plays one episode: simulation, policy, episode, and a clock (s) that stands still while it is set aside."""


@dataclass(frozen=True)
class Played:
    """How an episode ended."""

    episode: Episode
    result: EpisodeResult | Exception
    """Its record, or what was raised while it was played."""


def play_at_once(
    batch: SimulationBatch, policy: Policy, episodes: Sequence[Episode], play: Play, *, ask_together: bool = False
) -> Iterator[Played]:
    """Play episodes, as many at a time as the batch has members.

    A member in which something was raised is not used again; when none is left, what has not begun is not played.

    Args:
        batch: Open simulations of the episodes' task.
        policy: Acts in all of them.
        episodes: What to play.
        play: See `Play`.
        ask_together: Give the policy all waiting queries in one call; else one after the other, as when each episode
            is played alone.

    Yields:
        Episodes as they end, in any order.
    """
    waiting, free = deque(episodes), deque(range(len(batch.members)))
    rounds = _Rounds(batch, policy, ask_together)
    while (waiting and free) or rounds.members:
        while waiting and free:
            rounds.begin(free.popleft(), waiting.popleft(), play)
        for member in rounds.ended():
            assert member.result is not None
            if not isinstance(member.result, Exception):
                free.append(member.number)
            yield Played(member.episode, member.result)
        rounds.advance()


class _Clock:
    """Counts the seconds in which an episode is under way, and its part of what is done together."""

    def __init__(self) -> None:
        self._counted, self._since = 0.0, time.perf_counter()

    def __call__(self) -> float:
        return self._counted + time.perf_counter() - self._since

    def set_aside(self) -> None:
        self._counted = self()

    def go_on(self, part_s: float) -> None:
        self._counted, self._since = self._counted + part_s, time.perf_counter()


class _Member:
    """An episode under way, and what it waits for."""

    def __init__(self, number: int, batch: SimulationBatch, policy: Policy, episode: Episode, play: Play) -> None:
        self.number, self.episode = number, episode
        self.wish: _Wish | None = None
        self.what: Any = None
        self.result: EpisodeResult | Exception | None = None
        self._clock = _Clock()
        self._hub = greenlet.getcurrent()
        self._run = greenlet(lambda: self._play(play, _Sight(batch.members[number], self), _Asker(policy, self)))
        self._run.switch()

    def want(self, wish: _Wish, what: Any = None) -> Any:
        """Called by the episode: be set aside until it is done."""
        self.wish, self.what = wish, what
        self._clock.set_aside()
        return self._hub.switch()

    def go_on(self, done: Any, part_s: float) -> None:
        """Called by the hub: what was wanted is done, or could not be; it took so long."""
        self.wish = self.what = None
        self._clock.go_on(part_s)
        if isinstance(done, Exception):
            self._run.throw(done)
        else:
            self._run.switch(done)

    def _play(self, play: Play, simulation: Simulation, policy: Policy) -> None:
        try:
            self.result = play(simulation, policy, self.episode, self._clock)
        except Exception as error:  # simulators and policies raise anything; it ends this episode alone
            self.result = error


class _Rounds:
    """The episodes under way. In a round, what they wait for is done: looks and questions first, then steps."""

    def __init__(self, batch: SimulationBatch, policy: Policy, ask_together: bool) -> None:
        self._batch, self._policy, self._ask_together = batch, policy, ask_together
        self.members: list[_Member] = []

    def begin(self, number: int, episode: Episode, play: Play) -> None:
        self.members.append(_Member(number, self._batch, self._policy, episode, play))

    def ended(self) -> list[_Member]:
        """Those that have ended since; they are under way no more."""
        over = [member for member in self.members if member.result is not None]
        self.members = [member for member in self.members if member.result is None]
        return over

    def advance(self) -> None:
        """Do what the members wait for; nobody steps while somebody looks or asks."""
        if any(member.result is not None for member in self.members):
            return
        for wish, do in ((_Wish.LOOK, self._look), (_Wish.ANSWER, self._answer), (_Wish.STEP, self._step)):
            if wanting := [member for member in self.members if member.wish is wish]:
                do(wanting)
                return

    def _look(self, members: Sequence[_Member]) -> None:
        self._together(members, lambda: self._batch.observe([member.number for member in members]))

    def _step(self, members: Sequence[_Member]) -> None:
        self._together(members, lambda: self._batch.step({member.number: member.what for member in members}))

    def _answer(self, members: Sequence[_Member]) -> None:
        for asking in [members] if self._ask_together else [[member] for member in members]:
            queries = [query for member in asking for query in member.what]
            self._together(asking, partial(self._shared, asking, queries))

    def _shared(self, asking: Sequence[_Member], queries: Sequence[Query]) -> Mapping[int, Sequence[Decision]]:
        decisions = list(self._policy.act(queries))
        if len(asking) > 1 and len(decisions) != len(queries):
            raise ValueError(f"expected {len(queries)} decisions of the policy, got {len(decisions)}")
        shared = {}
        for member in asking[:-1]:
            shared[member.number], decisions = decisions[: len(member.what)], decisions[len(member.what) :]
        return shared | {asking[-1].number: decisions}

    def _together(self, members: Sequence[_Member], do: Callable[[], Mapping[int, Any]]) -> None:
        began = time.perf_counter()
        try:
            done: Mapping[int, Any] = do()
            if absent := [member.number for member in members if member.number not in done]:
                raise ValueError(f"expected what became of member {absent[0]} of the batch, got nothing")
        except Exception as error:
            done = {member.number: error for member in members}
        part_s = (time.perf_counter() - began) / len(members)
        for member in members:
            member.go_on(done[member.number], part_s)


class _Sight(Around):
    """A member's simulation as its episode sees it."""

    def __init__(self, simulation: Simulation, member: _Member) -> None:
        super().__init__(simulation)
        self._member = member

    def observe(self) -> Observation:
        seen: Observation = self._member.want(_Wish.LOOK)
        return seen

    def step(self, action: FloatArray) -> StepOutcome:
        outcome: StepOutcome = self._member.want(_Wish.STEP, action)
        return outcome


class _Asker:
    """A policy as a member's episode sees it."""

    def __init__(self, policy: Policy, member: _Member) -> None:
        self.spec = policy.spec
        self._policy, self._member = policy, member

    def reset(self, episodes: Sequence[Episode]) -> None:
        self._policy.reset(episodes)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        decisions: Sequence[Decision] = self._member.want(_Wish.ANSWER, list(queries))
        return decisions

    def finish(self, episodes: Sequence[Episode]) -> None:
        self._policy.finish(episodes)
