"""Episodes that are played at once in one process: the same rows as alone."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.catalog import open_batch
from orchestrator.lockstep import play_at_once
from orchestrator.rollout import rollout
from orchestrator.runner import EpisodeRunner, Lease
from orchestrator.sources import PolicySource
from policies.catalog import load
from results.record import EpisodeResult, outcome_row
from suites.placement import Resources
from suites.vocabulary import Cell, Condition, Protocol, RenderProfile, View

NAMES = ("oracle", "random", "untrained")
SOURCES = {name: PolicySource(name) for name in NAMES}
VIEW = View(("third_person", "wrist"), 16)


def cell(task="null/Reach", policy="oracle", condition=None, horizon=60, view=VIEW):
    return Cell(policy, policy, task, Protocol(horizon, 4, view), condition or Condition())


def rows(seeds, at_once, one=None, **resources):
    runner = EpisodeRunner(SOURCES, resources=Resources(at_once=at_once, **resources))
    try:
        return list(runner.play(Lease(one or cell(), tuple(seeds))))
    finally:
        runner.close()


def outcomes(results):
    return [outcome_row(result) for result in results]


def at_once_in(batch, policy, seeds, one=None, **more):
    def play(simulation, policy, episode, clock):
        return rollout(simulation, policy, episode, clock=clock)

    return list(play_at_once(batch, policy, [(one or cell()).episode(seed) for seed in seeds], play, **more))


@given(
    st.lists(st.integers(0, 30), min_size=1, max_size=8, unique=True),
    st.integers(2, 5),
    st.sampled_from(NAMES),
    st.sampled_from([Condition(), Condition("action-noise", 3), Condition("action-delay", 2), Condition("noise", 2)]),
    st.booleans(),
)
def test_rows_and_their_order_are_those_of_episodes_played_alone(seeds, at_once, policy, condition, together):
    one = cell(policy=policy, condition=condition)
    assert outcomes(rows(seeds, at_once, one, ask_together=together)) == outcomes(rows(seeds, 1, one))


@pytest.mark.simulator
@pytest.mark.parametrize(
    ("task", "condition"),
    [
        ("maniskill/PushCube-v1", Condition("object-position", 2)),
        ("pybullet/PandaPush-v3", Condition("camera-orbit", 3)),
        ("robosuite/Lift", Condition()),
    ],
)
def test_three_of_a_real_simulator_at_once_play_the_rows_of_one(task, condition):
    view = View(("third_person", "wrist"), 64, RenderProfile.FAST)
    one = cell(task, "untrained", condition, 16, view)
    assert outcomes(rows(range(5), 3, one)) == outcomes(rows(range(5), 1, one))


def test_what_a_simulator_raises_ends_one_episode_and_no_other():
    results = rows((6, 7, 8, 9), 4, cell("null/Raise"))
    assert [result.status for result in results] == ["success", "error", "success", "success"]
    assert results[1].error.startswith("RuntimeError: the null simulator was asked to raise [null.py:")


def test_what_went_wrong_once_is_played_again_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOGAUNTLET_NULL_MARKER", str(tmp_path))
    assert {result.status for result in rows((6, 7, 14, 21), 4, cell("null/Raise"))} == {"success"}


class Counting:
    """A batch that notes who took part in each call."""

    def __init__(self, count, fails_at=None):
        self._batch, self._fails_at = open_batch("null/Reach", VIEW, count), fails_at
        self.members, self.steps, self.looks = self._batch.members, [], []

    def step(self, actions):
        self.steps.append(sorted(actions))
        if len(self.steps) == self._fails_at:
            raise RuntimeError("the engine fails")
        return self._batch.step(actions)

    def observe(self, members):
        self.looks.append(sorted(members))
        return self._batch.observe(members)

    def close(self):
        self._batch.close()


class Silent(Counting):
    """A batch that says nothing of its last member."""

    def step(self, actions):
        return {member: outcome for member, outcome in super().step(actions).items() if member != 1}


def test_a_batch_that_leaves_a_member_out_fails_its_episodes_and_not_the_worker():
    played = at_once_in(Silent(2), load("untrained", {}), range(2))
    assert {str(one.result) for one in played} == {"expected what became of member 1 of the batch, got nothing"}


class Asked:
    """A policy that notes how much it was asked at once."""

    def __init__(self, name, answers=None):
        self._policy, self._answers, self.sizes = load(name, {}), answers, []
        self.spec, self.reset, self.finish = self._policy.spec, self._policy.reset, self._policy.finish

    def act(self, queries):
        self.sizes.append(len(queries))
        return list(self._policy.act(queries))[: self._answers]


def test_all_that_are_under_way_step_and_look_together():
    batch = Counting(3)
    played = at_once_in(batch, load("untrained", {}), range(3))
    assert len(played) == 3
    assert {tuple(step) for step in batch.steps} == {(0, 1, 2)}
    assert {tuple(look) for look in batch.looks} == {(0, 1, 2)}
    assert len(batch.steps) == 60


def test_the_next_episode_takes_the_place_of_one_that_ended():
    batch = Counting(2)
    played = at_once_in(batch, load("oracle", {}), range(9))
    assert {one.episode.seed for one in played} == set(range(9))
    assert {member for step in batch.steps for member in step} == {0, 1}
    alone = sum(one.result.steps for one in played)
    assert len(batch.steps) < 0.7 * alone


@pytest.mark.parametrize(("together", "sizes"), [(True, {4}), (False, {1})])
def test_a_policy_is_asked_about_all_at_once_only_if_it_shall_be(together, sizes):
    policy = Asked("untrained")
    at_once_in(Counting(4), policy, range(4), ask_together=together)
    assert set(policy.sizes) == sizes


def test_too_few_answers_are_an_error_of_all_that_asked():
    played = at_once_in(Counting(4), Asked("untrained", answers=3), range(4), ask_together=True)
    assert {str(one.result) for one in played} == {"expected 4 decisions of the policy, got 3"}


def test_an_engine_that_fails_ends_what_is_under_way_and_what_has_not_begun_is_left():
    played = at_once_in(Counting(2, fails_at=5), load("untrained", {}), range(6))
    assert [str(one.result) for one in played] == ["the engine fails"] * 2


def test_episodes_are_charged_what_they_took_and_not_what_others_did():
    batch = open_batch("null/Slow", VIEW, 4)
    one = cell("null/Slow")
    began = time.perf_counter()
    played = at_once_in(batch, load("oracle", {}), range(8), one)
    elapsed = time.perf_counter() - began
    results = [each.result for each in played]
    assert all(isinstance(result, EpisodeResult) for result in results)
    assert sum(result.wall_s for result in results) <= elapsed
    for result in results:
        assert result.reset_s + result.physics_s + result.render_s + result.inference_s <= result.wall_s
