"""One demonstration: noise in the executed action, the oracle's action in the record."""

import numpy as np
import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.demonstrations.recorder import (
    LEARNER_REPLANS_EVERY,
    Learner,
    RecordedSimulation,
    demonstrate,
)
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.policies.contract import Decision, PolicyError, PolicyInput, PolicySpec, StatelessPolicy
from robogauntlet.suites.episode import Episode, Protocol, View

VIEW = View(image_size=16)


def episode(seed=0, task="null/Reach", **changes):
    return Episode("oracle", "digest", task, seed, Protocol(60, 1, VIEW), **changes)


@pytest.fixture
def runner():
    made = EpisodeRunner({"oracle": PolicySource("oracle")})
    yield made
    made.close()


def test_the_same_episode_gives_the_same_record(runner):
    first, other, again = (demonstrate(runner, episode(seed), 0.1)[1] for seed in (3, 4, 3))
    assert first.content_hash == again.content_hash
    assert first.content_hash != other.content_hash


def test_the_noise_is_keyed_by_the_episode_not_by_its_seed_alone(runner):
    other = Episode("oracle", "another digest", "null/Reach", 3, Protocol(60, 1, VIEW))
    records = [demonstrate(runner, which, 0.1)[1] for which in (episode(3), other)]
    assert records[0].content_hash != records[1].content_hash


def begin(noise, learner=None):
    """The null simulation under a recorder after the reset, and a list of the actions that it executes."""
    simulation, executed = catalog.open_simulation("null/Reach", VIEW), []
    step = simulation.step
    simulation.step = lambda action: executed.append(action) or step(action)
    recorded = RecordedSimulation(simulation, episode(), noise, learner)
    recorded.reset(0)
    return recorded, simulation, executed


def test_the_executed_action_is_disturbed_and_the_clean_one_recorded():
    recorded, simulation, executed = begin(0.2)
    clean = np.array([0.01, 0.0, -0.01, 0.0, 0.0, 0.0, 0.0])
    for _ in range(400):
        recorded.step(clean)
    found = recorded.recording()
    assert np.all(found.actions == clean)
    assert np.all(np.abs(executed) <= simulation.action_spec.high)
    deviation = (np.array(executed) - clean)[:, :3].std(axis=0)
    assert deviation == pytest.approx(0.2 * simulation.action_spec.max_translation, rel=0.15)
    assert np.all(np.array(executed)[:, 3:] == 0.0)


def test_observations_precede_the_step():
    recorded, simulation, _ = begin(0.0)
    positions = [simulation.observe().proprioception]
    for _ in range(3):
        recorded.step(np.array([0.02, 0, 0, 0, 0, 0, 0]))
        positions.append(simulation.observe().proprioception)
    found = recorded.recording()
    assert np.array_equal(found.states, positions[:-1])
    assert set(found.images) == set(VIEW.cameras)


class Sideways(StatelessPolicy):
    """Moves along y, whatever it observes."""

    spec = PolicySpec(PolicyInput.OBSERVATION, chunk_length=8)

    def __init__(self):
        self.queried_steps = []

    def act(self, queries):
        self.queried_steps += [query.step for query in queries]
        return [Decision(np.tile([0.0, 0.01, 0, 0, 0, 0, 0], (8, 1))) for _ in queries]


def test_a_learner_acts_until_the_handover_and_the_oracles_actions_are_recorded():
    learner = Learner(Sideways(), episode(), 40)
    recorded, _, executed = begin(0.0, learner)
    clean = np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(50):
        recorded.step(clean)
    own = np.array(executed)[:, 1] == 0.01
    assert 0 < learner.handover_step < 40
    assert own[: learner.handover_step].all()
    assert not own[learner.handover_step :].any()
    assert recorded.recorded_steps == 50 - learner.handover_step
    found = recorded.recording()
    assert np.all(found.actions == clean)
    assert len(found.actions) == len(found.states) == len(found.images["wrist"]) == recorded.recorded_steps
    assert learner.policy.queried_steps == list(range(0, learner.handover_step, LEARNER_REPLANS_EVERY))


def test_whole_episodes_are_recorded_on_request():
    recorded, _, _ = begin(0.0, Learner(Sideways(), episode(), 40, recorded=True))
    commanded = np.array([[0.001 * step, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] for step in range(50)])
    for action in commanded:
        recorded.step(action)
    np.testing.assert_array_equal(recorded.recording().actions, commanded)


def test_handover_steps_are_uniform():
    steps = [Learner(Sideways(), episode(seed), 10).handover_step for seed in range(2000)]
    assert np.bincount(steps, minlength=10) == pytest.approx(200, abs=60)


def test_a_learner_that_sees_no_observations_is_refused():
    blind = Sideways()
    blind.spec = PolicySpec(PolicyInput.NOTHING, chunk_length=8)
    with pytest.raises(PolicyError, match="expected a learner that sees observations, got one that sees nothing"):
        Learner(blind, episode(), 10)


def test_an_episode_with_a_learner_repeats_and_differs_from_one_without(runner):
    with_learner, again = (demonstrate(runner, episode(3), 0.1, Sideways())[1] for _ in range(2))
    without = demonstrate(runner, episode(3), 0.1)[1]
    assert with_learner.content_hash == again.content_hash != without.content_hash


class Reaching(Sideways):
    """Moves straight to a goal that the test sets."""

    def __init__(self, goal):
        super().__init__()
        self.goal = goal

    def act(self, queries):
        steps = [np.clip(self.goal - query.observation.proprioception[:3], -0.05, 0.05) for query in queries]
        return [Decision(np.array([[*step, 0.0, 0.0, 0.0, 0.0]])) for step in steps]


def test_an_episode_that_the_learner_finishes_has_no_record(runner, monkeypatch):
    simulation = catalog.open_simulation("null/Reach", VIEW)
    simulation.reset(3)
    learner = Reaching(simulation.privileged_state()["goal_position"])
    monkeypatch.setattr(Learner, "__post_init__", lambda self: setattr(self, "handover_step", 10_000))
    attempt, record = demonstrate(runner, episode(3), 0.0, learner)
    assert attempt.steps < 60
    assert (attempt.status, record) == ("failure", None)


def test_a_failed_episode_has_no_record(runner):
    attempts = [demonstrate(runner, episode(seed), 1.0) for seed in range(6)]
    failed = [encoded for attempt, encoded in attempts if attempt.status == "failure"]
    assert failed
    assert set(failed) == {None}
    assert all(encoded is not None for attempt, encoded in attempts if attempt.status == "success")


def test_an_exception_of_a_simulator_is_an_error_without_a_record(runner):
    attempt, encoded = demonstrate(runner, episode(7, "null/Raise"), 0.1)
    assert (attempt.status, encoded) == ("error", None)
    assert attempt.error.startswith("RuntimeError: the null simulator was asked to raise")


@pytest.mark.simulator
def test_a_demonstration_in_pybullet_is_recorded_and_repeats(runner):
    records = [demonstrate(runner, episode(1_000_000, "pybullet/PandaReach-v3"), 0.1)[1] for _ in range(2)]
    assert records[0].content_hash == records[1].content_hash
    assert records[0].success[-5:].all()
    assert records[0].spec.fps == 25
