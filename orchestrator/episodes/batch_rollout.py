"""Episodes in several worlds of one task at once, each played as `rollout` plays it alone."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator

from robogauntlet.adapters.contract import AdapterError, BatchSimulation, Simulation, StepOutcome
from robogauntlet.orchestrator.episodes.rollout import ask, played
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.policies.contract import Decision, Policy, Query
from robogauntlet.results.record import EpisodeResult
from robogauntlet.suites.episode import Episode


class _World:
    """A world with its episode and its own clock."""

    def __init__(self, simulation: Simulation, policy: Policy, episode: Episode, references: ReferenceImages) -> None:
        self.seconds = self._resumed = 0.0
        """Time spent on this world: on it alone, and its share of what is done for several."""
        self.query: Query | None = None
        """What it waits for an answer to; None if it waits for its step."""
        self._playing = played(simulation, policy, episode, references=references, clock=self._clock)
        self.resume(None)

    def resume(self, answer: Decision | StepOutcome | None) -> EpisodeResult | None:
        """Give it what it waits for, and play on until it waits again. Return the record if the episode has ended."""
        self._resumed = time.perf_counter()
        try:
            waits_for = self._playing.send(answer)
            self.query = waits_for if isinstance(waits_for, Query) else None
        except StopIteration as ended:
            row: EpisodeResult = ended.value
            return row
        finally:
            self.seconds += time.perf_counter() - self._resumed
        return None

    def _clock(self) -> float:
        return self.seconds + time.perf_counter() - self._resumed


def rollouts(batch: BatchSimulation, policy: Policy, episodes: Iterable[Episode]) -> Iterator[EpisodeResult]:
    """Play episodes in the worlds of a batch; a world whose episode has ended begins the next one.

    The policy is asked once for all worlds that need an answer before a step. Perturbations and latencies are a world's
    own, as in `rollout`.

    Args:
        batch: The task of the episodes, open.
        policy: A policy that `check_fit` has accepted.
        episodes: Of one task and view, such as those of a lease.

    Yields:
        The records in the order in which episodes end. Durations are those of the world, with its share of answers and
        steps, so that they add up to the time that all have taken.

    Raises:
        Exception: As `rollout`, of any of the worlds. The episodes without a record are then to be played one by one,
            which tells whose error it is.
    """
    waiting, references = iter(episodes), ReferenceImages()
    playing: dict[int, _World] = {}
    while True:
        free = [place for place in range(len(batch.worlds)) if place not in playing]
        for place, episode in zip(free, waiting, strict=False):
            playing[place] = _World(batch.worlds[place], policy, episode, references)
        if not playing:
            return
        while asking := [(world, world.query) for world in playing.values() if world.query is not None]:
            began = time.perf_counter()
            decisions = ask(policy, [query for _, query in asking])
            _share([world for world, _ in asking], began)
            for (world, _), decision in zip(asking, decisions, strict=True):
                if world.resume(decision) is not None:
                    raise AdapterError("a world of a batch: expected PENDING of a step, got its outcome")
        began = time.perf_counter()
        outcomes = batch.advance()
        _share(playing.values(), began)
        for place, world in list(playing.items()):
            if (row := world.resume(outcomes[place])) is not None:
                del playing[place]
                yield row


def _share(worlds: Collection[_World], began: float) -> None:
    """Charge worlds for what was done for all of them since then."""
    share = (time.perf_counter() - began) / len(worlds)
    for world in worlds:
        world.seconds += share
