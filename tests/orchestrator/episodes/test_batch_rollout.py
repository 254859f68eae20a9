"""Episodes in several worlds at once have the records of episodes that are played alone."""

import time

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.adapters.contract import AdapterError
from robogauntlet.adapters.null import NullBatch
from robogauntlet.orchestrator.episodes.batch_rollout import rollouts
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import Decision, PolicyError, PolicyInput, PolicySpec, StatelessPolicy
from robogauntlet.results.record import outcome_row
from robogauntlet.suites.conditions import read_condition
from robogauntlet.suites.episode import Episode, Protocol, View
from robogauntlet.suites.timing import read_timing

VIEW = View(image_size=8)
CONDITIONS = (
    *("clean", "action-noise@3", "action-delay@4", "noise@2", "frozen-frames@3", "latency@4", "latency-continue@3"),
    *("blind@1", "blank-instruction@1", "action-delay@2+noise@3"),
)
"""Conditions that the null simulator has, of actions, images, latencies and instructions."""


class Towards(StatelessPolicy):
    """Goes to the seed's goal, sooner or later, with noise and by what it sees."""

    def __init__(self, sees, length):
        self.spec = PolicySpec(sees, length)
        self.batches = []

    def act(self, queries):
        self.batches.append([query.episode.seed for query in queries])
        return [Decision(self._chunk(query)) for query in queries]

    def _chunk(self, query):
        seed, length = query.episode.seed, self.spec.chunk_length
        chunk = np.random.default_rng([int(query.episode.id, 16), query.step]).normal(0, 1e-3, (length, 7))
        drawn = np.random.default_rng([seed, 0])
        start, goal = drawn.uniform(-0.5, 0.5, 3), drawn.uniform(-0.5, 0.5, 3)
        steps = np.arange(query.step, query.step + length)[:, None]
        chunk[:, :3] += np.where(steps < 10 + seed % 20, (goal - start) / (10 + seed % 20), 0.0)
        if query.privileged_state is not None:
            chunk[:, :3] += (goal - query.privileged_state["tcp_position"]) / 50
        if query.observation is not None:
            chunk[:, :3] += query.observation.images["wrist"].mean() / 1e5
        return chunk


@st.composite
def plays(draw):
    seeds = draw(st.lists(st.integers(0, 500), min_size=1, max_size=9, unique=True))
    timing = draw(st.sampled_from([None, "hold:80ms", "continue:120ms", "blend:60ms"]))
    condition = read_condition(draw(st.sampled_from(CONDITIONS if timing is None else CONDITIONS[:5])))
    length = draw(st.integers(1, 8))
    protocol = Protocol(draw(st.integers(1, 60)), draw(st.integers(1, 8)), VIEW, timing=read_timing(timing))
    policy = Towards(draw(st.sampled_from(PolicyInput)), length)
    episodes = [Episode("p", "p", "null/Reach", seed, protocol, condition) for seed in seeds]
    return episodes, policy, draw(st.integers(1, 6))


@settings(max_examples=200)
@given(plays())
def test_each_record_is_that_of_the_episode_alone(drawn):
    episodes, policy, worlds = drawn
    alone = open_simulation("null/Reach", VIEW)
    expected = sorted(outcome_row(rollout(alone, policy, episode)) for episode in episodes)
    asked, policy.batches = sum(map(len, policy.batches)), []
    found = list(rollouts(NullBatch("Reach", VIEW, worlds), policy, episodes))
    assert sorted(map(outcome_row, found)) == expected
    assert sum(map(len, policy.batches)) == asked
    assert all(len(batch) == len({*batch}) <= worlds for batch in policy.batches)


def test_the_policy_is_asked_once_for_all_worlds_and_a_free_world_takes_the_next_episode():
    policy = Towards(PolicyInput.NOTHING, 8)
    episodes = [Episode("p", "p", "null/Reach", seed, Protocol(16, 8, VIEW)) for seed in range(5)]
    rows = list(rollouts(NullBatch("Reach", VIEW, 2), policy, episodes))
    assert [row.seed for row in rows] == [0, 1, 2, 3, 4]
    assert policy.batches == [[0, 1], [0, 1], [2, 3], [2, 3], [4], [4]]


def test_durations_of_worlds_add_up_to_the_time_of_all():
    policy = Towards(PolicyInput.OBSERVATION, 2)
    episodes = [Episode("p", "p", "null/Slow", seed, Protocol(20, 2, VIEW)) for seed in range(6)]
    start = time.perf_counter()
    rows = list(rollouts(NullBatch("Slow", VIEW, 4), policy, episodes))
    elapsed = time.perf_counter() - start
    assert 0.5 * elapsed < sum(row.wall_s for row in rows) <= elapsed


def test_an_error_in_a_world_ends_the_batch():
    class Short(Towards):
        def act(self, queries):
            return super().act(queries)[:1]

    episodes = [Episode("p", "p", "null/Reach", seed, Protocol(16, 8, VIEW)) for seed in range(3)]
    with pytest.raises(PolicyError, match="expected one Decision for 3 queries, got 1 answers"):
        list(rollouts(NullBatch("Reach", VIEW, 4), Short(PolicyInput.NOTHING, 8), episodes))
    with pytest.raises(RuntimeError, match="asked to raise"):
        list(rollouts(NullBatch("Raise", VIEW, 4), Towards(PolicyInput.NOTHING, 8), episodes))
    batch = NullBatch("Reach", VIEW, 2)
    batch.worlds = [open_simulation("null/Reach", VIEW)]
    with pytest.raises(AdapterError, match="expected PENDING of a step, got its outcome"):
        list(rollouts(batch, Towards(PolicyInput.NOTHING, 8), episodes))
