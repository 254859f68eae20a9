"""One episode: queries, rendering, outcome and record."""

import numpy as np
import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.adapters.contract import AdapterError, StepOutcome
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import Decision, PolicyInput, PolicyMismatch, PolicySpec, Routing, StatelessPolicy
from robogauntlet.results.record import outcome_row
from robogauntlet.suites.episode import SUCCESS_HOLD, Episode, Protocol, ProtocolName, SuccessRule, View


class Scripted(StatelessPolicy):
    """Answers with chunks of a fixed length, and records the steps of its queries."""

    def __init__(self, chunk=None, sees=PolicyInput.OBSERVATION):
        self.chunk = np.zeros((8, 7)) if chunk is None else chunk
        self.spec = PolicySpec(sees, len(self.chunk))
        self.asked = []

    def act(self, queries):
        self.asked += [query.step for query in queries]
        return [Decision(self.chunk) for _ in queries]


class Counting:
    """The null simulation with a given success signal; counts calls."""

    def __init__(self, success=lambda step: False, terminated=lambda step: False):
        self.inner = open_simulation("null/Reach", View())
        self.action_spec, self.observation_spec = self.inner.action_spec, self.inner.observation_spec
        self.observed, self.stepped, self.actions = 0, 0, []
        self.success, self.terminated = success, terminated

    def observe(self):
        self.observed += 1
        return self.inner.observe()

    def step(self, action):
        self.stepped += 1
        self.actions.append(action)
        self.inner.step(action)
        return StepOutcome(0.5, self.success(self.stepped), self.terminated(self.stepped))

    def __getattr__(self, name):
        return getattr(self.inner, name)


def episode(horizon=40, replan_every=8, policy="p", protocol=ProtocolName.ROBOGAUNTLET, rule=None):
    return Episode(policy, policy, "null/Reach", 3, Protocol(horizon, replan_every, name=protocol, success=rule))


def test_images_are_rendered_once_per_chunk():
    simulation, policy = Counting(), Scripted()
    result = rollout(simulation, policy, episode(horizon=40, replan_every=8))
    assert policy.asked == [0, 8, 16, 24, 32]
    assert (simulation.observed, result.queries, result.steps) == (5, 5, 40)


def test_a_policy_is_queried_again_after_a_chunk_shorter_than_the_protocol_allows():
    policy = Scripted(np.zeros((3, 7)))
    rollout(Counting(), policy, episode(horizon=9, replan_every=8))
    assert policy.asked == [0, 3, 6]


@pytest.mark.parametrize("sees", [PolicyInput.NOTHING, PolicyInput.PRIVILEGED_STATE])
def test_a_policy_that_does_not_observe_causes_no_rendering(sees):
    simulation = Counting()
    rollout(simulation, Scripted(sees=sees), episode())
    assert simulation.observed == 0


def test_success_needs_the_predicate_for_steps_in_a_row_and_ends_the_episode():
    simulation = Counting(success=lambda step: step >= 6)
    result = rollout(simulation, Scripted(), episode())
    assert (result.status, result.steps) == ("success", 5 + SUCCESS_HOLD)


def test_a_flickering_predicate_is_recorded_but_no_success():
    simulation = Counting(success=lambda step: step % SUCCESS_HOLD != 0)
    result = rollout(simulation, Scripted(), episode())
    assert (result.status, result.success_once, result.steps) == ("failure", True, 40)


def test_under_the_protocol_openvla_the_first_step_of_the_predicate_is_a_success():
    simulation = Counting(success=lambda step: step == 6)
    result = rollout(simulation, Scripted(), episode(protocol=ProtocolName.OPENVLA))
    assert (result.status, result.steps, result.protocol) == ("success", 6, "openvla")
    assert result.time_to_success == pytest.approx(6 / simulation.action_spec.control_hz)


def test_where_success_counts_once_the_first_step_of_the_predicate_ends_the_episode():
    result = rollout(Counting(success=lambda step: step == 6), Scripted(), one := episode(rule=SuccessRule.ONCE))
    assert (result.status, result.steps, result.protocol, result.success_rule) == ("success", 6, None, "once")
    assert result.episode == one


def test_under_the_protocol_openvla_success_may_have_to_be_held():
    one = episode(protocol=ProtocolName.OPENVLA, rule=SuccessRule.HELD)
    result = rollout(Counting(success=lambda step: step >= 6), Scripted(), one)
    assert (result.status, result.steps, result.success_rule) == ("success", 5 + SUCCESS_HOLD, "held")


def test_under_the_protocol_openvla_policies_see_mirrored_images():
    class Seeing(Scripted):
        def act(self, queries):
            self.images = queries[0].observation.images
            return super().act(queries)

    upright, mirrored = Seeing(), Seeing()
    rollout(Counting(), upright, episode(horizon=8))
    rollout(Counting(), mirrored, episode(horizon=8, protocol=ProtocolName.OPENVLA))
    for name, image in upright.images.items():
        np.testing.assert_array_equal(mirrored.images[name], image[:, ::-1])


def test_success_at_the_horizon_counts():
    simulation = Counting(success=lambda step: step > 35)
    assert rollout(simulation, Scripted(), episode(horizon=40)).status == "success"


def test_a_terminated_simulation_ends_the_episode_as_a_failure():
    result = rollout(Counting(terminated=lambda step: step == 7), Scripted(), episode())
    assert (result.status, result.steps) == ("failure", 7)


def test_a_simulation_that_terminates_in_success_ends_the_episode_as_a_success():
    simulation = Counting(success=lambda step: step == 7, terminated=lambda step: step == 7)
    result = rollout(simulation, Scripted(), episode())
    assert (result.status, result.steps, simulation.stepped) == ("success", 7, 7)
    assert result.time_to_success == pytest.approx(7 / simulation.action_spec.control_hz)


def test_eager_rendering_affects_only_the_duration():
    policy, simulation = load("untrained", {}), Counting()
    lazy, eager = rollout(Counting(), policy, episode()), rollout(simulation, policy, episode(), eager=True)
    assert simulation.observed == 40 + 5
    assert outcome_row(lazy) == outcome_row(eager)


def test_actions_beyond_the_bounds_are_clipped_and_counted():
    chunk = np.zeros((8, 7))
    chunk[0, 0], chunk[1, 0] = 9.0, -9.0
    simulation = Counting()
    result = rollout(simulation, Scripted(chunk), episode(horizon=8))
    assert result.clipped_steps == 2
    assert [action[0] for action in simulation.actions[:2]] == [0.05, -0.05]


def test_ignored_dimensions_are_zeroed_and_never_count_as_clipped():
    chunk = np.full((8, 7), 0.01)
    chunk[:, 3] = 99.0
    simulation = Counting()
    result = rollout(simulation, Scripted(chunk), episode(horizon=8))
    assert result.clipped_steps == 0
    assert all((action[3:] == 0).all() for action in simulation.actions)


@pytest.mark.parametrize(
    ("chunk", "message"),
    [
        (np.zeros((8, 6)), r"shape \(n, 7\) with n >= 1, got \(8, 6\)"),
        (np.zeros((0, 7)), r"got \(0, 7\)"),
        (np.zeros(7), r"got \(7,\)"),
        (np.full((8, 7), np.nan), "finite actions, got nan"),
        ([["a"] * 7], "action chunk of numbers"),
    ],
)
def test_an_invalid_answer_is_refused_before_it_is_executed(chunk, message):
    simulation, policy = Counting(), Scripted()
    policy.chunk = chunk
    with pytest.raises(PolicyMismatch, match=message):
        rollout(simulation, policy, episode())
    assert simulation.stepped == 0


def test_the_reward_is_summed():
    assert rollout(Counting(), Scripted(), episode(horizon=10)).reward_sum == 5.0


def test_a_reward_that_is_not_finite_is_an_error_of_the_simulator():
    simulation = Counting()
    simulation.step = lambda action: StepOutcome(float("nan"), False)
    with pytest.raises(AdapterError, match="rewards add up to nan, expected a finite number"):
        rollout(simulation, Scripted(), episode())


def test_the_first_routing_decision_is_recorded():
    class Router(Scripted):
        def act(self, queries):
            routing = Routing({"b": 0.1, "a": 0.9}, "a" if not self.asked else "b", 0.0)
            self.asked += [query.step for query in queries]
            return [Decision(self.chunk, routing) for _ in queries]

    result = rollout(Counting(), Router(), episode())
    assert (result.inferred_task, result.routing_scores) == ("a", '{"a": 0.9, "b": 0.1}')


class Routes(Scripted):
    """Answers with fixed routing evidence."""

    def __init__(self, routing):
        super().__init__()
        self.routing = routing

    def act(self, queries):
        return [Decision(self.chunk, self.routing) for _ in queries]


def test_routing_evidence_is_recorded_rounded():
    scores = {"b": np.float32(-0.1234567), "a": -4e-7}
    result = rollout(Counting(), Routes(Routing(scores, "a", 0.25, unknown=1.23456789, rejected=np.True_)), episode())
    assert result.routing_scores == '{"a": 0.0, "b": -0.123457}'
    assert (result.unknown_score, result.rejected, result.routing_s) == (1.234568, True, 0.25)


def test_a_policy_without_a_router_records_no_routing():
    result = rollout(Counting(), Scripted(), episode())
    assert (result.inferred_task, result.unknown_score, result.rejected, result.routing_s) == (None, None, None, 0.0)


@pytest.mark.parametrize(
    ("routing", "message"),
    [
        (Routing({"a": float("nan")}, "a", 0.0), "finite number as the router's score of a, got nan"),
        (Routing({"a": float("-inf")}, "a", 0.0), "score of a, got -inf"),
        (Routing({"a": 0.0, "b": 0.0}, "c", 0.0), "choice among a, b; got c"),
        (Routing({"a": 0.0}, "a", -1.0), "latency of 0 s or more, got -1.0"),
        (Routing({"a": 0.0}, "a", 0.0, unknown=float("inf")), "score for an unknown task, got inf"),
    ],
)
def test_invalid_routing_evidence_is_refused(routing, message):
    with pytest.raises(PolicyMismatch, match=message):
        rollout(Counting(), Routes(routing), episode())


def test_a_watcher_sees_every_step():
    seen = []
    rollout(Counting(), Scripted(), episode(horizon=10), watcher=lambda simulation, step: seen.append(step))
    assert seen == list(range(11))


def test_phases_add_up_to_no_more_than_the_whole():
    result = rollout(Counting(), load("untrained", {}), episode())
    phases = result.reset_s + result.physics_s + result.render_s + result.inference_s
    assert 0 < phases <= result.wall_s
    assert 0 < result.query_p50_s <= result.query_p95_s <= result.query_max_s <= result.inference_s
