"""The no-skill baselines act in every task, within its bounds, and as ever where one arm's tool is moved."""

import hashlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from robogauntlet.adapters.contract import ActionSpec, Joint, Number, Observation
from robogauntlet.adapters.motion import standing_still
from robogauntlet.orchestrator.inference.ray_policy_server import _black_queries
from robogauntlet.policies.catalog import digest, load
from robogauntlet.policies.contract import PolicyMismatch, Query
from robogauntlet.suites.episode import Cell, Episode, Protocol
from tests.errors import one_line_error

JOINTS = ActionSpec(0.0, 0.0, 20.0, joints=(Joint("first", -0.5, 2.0, 0.1), Joint("second", 1.0, 1.5, 0.1)))
BODIES = {"one arm": ActionSpec(0.05, 0.1, 20.0), "two arms": ActionSpec(0.05, 0.1, 20.0, arms=2), "joints": JOINTS}
ACTIONS = {
    ("zero", "one arm"): "aaae73cea5bf4bb0",
    ("zero", "two arms"): "de13ffbe728d3ab8",
    ("zero", "joints"): "d8083b6e043db404",
    ("random", "one arm"): "4a3f66c4cac2c90a",
    ("random", "two arms"): "1ff0fe62c69b6b8a",
    ("random", "joints"): "70d8c5ae869813e9",
    ("untrained", "one arm"): "aed40df777742fe2",
    ("untrained", "two arms"): "7bed7a16be3f8ba7",
    ("untrained", "joints"): "28fde2cbef5785c1",
}
"""Hash of the first chunk."""
DIGESTS = {"zero": "67788518d0222cf8", "random": "ba470e9c682f3391", "untrained": "1e9b7a8fa8ba2bb5"}


def query(spec, step=8):
    generator = np.random.default_rng(4)
    images = {"third_person": generator.integers(0, 255, (24, 24, 3)).astype(np.uint8)}
    seen = Observation(images, generator.normal(size=spec.body.proprioception_dim), "go", bool(spec.joints))
    state = {"joint_targets": generator.uniform(spec.low, spec.high)[:-1]}
    still = standing_still(SimpleNamespace(action_spec=spec, privileged_state=lambda: state))
    return Query(Episode("p", "p", "null/Reach", 3, Protocol(40, 8)), step, seen, None, spec, still)


@pytest.mark.parametrize(("policy", "body"), ACTIONS)
def test_actions_are_the_same_as_long_as_the_digest_is(policy, body):
    (decision,) = load(policy, {}).act([query(BODIES[body])])
    assert digest(policy, {}) == DIGESTS[policy]
    assert hashlib.sha256((np.round(decision.actions, 6) + 0.0).tobytes()).hexdigest()[:16] == ACTIONS[policy, body]


@pytest.mark.parametrize(("task", "numbers"), [("so101/Push", 6), ("robosuite/TwoArmLift@TwoPandas", 14)])
def test_a_served_baseline_answers_when_its_time_is_measured(task, numbers):
    cell = Cell("untrained", "untrained", task, Protocol(40, 8))
    (decision,) = load("untrained", {}).act(_black_queries(cell, 1))
    assert decision.actions.shape == (8, numbers)


@pytest.mark.parametrize("policy", ["random", "untrained"])
def test_targets_are_within_the_limits_of_joints_and_fill_them(policy):
    baseline = load(policy, {})
    chunks = [baseline.act([query(JOINTS, step)])[0].actions for step in range(0, 400, 8)]
    low, high = np.concatenate(chunks).min(axis=0), np.concatenate(chunks).max(axis=0)
    assert (low >= JOINTS.low).all()
    assert (high <= JOINTS.high).all()
    if policy == "random":
        np.testing.assert_allclose((low - JOINTS.low, JOINTS.high - high), 0.0, atol=0.05)


NATIVE = ActionSpec(0.0, 0.0, 20.0, numbers=(Number("x", 0.0, 512.0), Number("y", -1.0, 1.0)), state=("x",))


@pytest.mark.parametrize("policy", ["random", "untrained"])
def test_native_numbers_are_within_their_bounds_and_those_without_are_refused_in_a_line(policy):
    asked = query(JOINTS)
    seen = replace(asked.observation, of_joints=False, native=2)
    chunk = load(policy, {}).act([replace(asked, observation=seen, action_spec=NATIVE)])[0].actions
    assert chunk.shape == (8, 2)
    assert ((NATIVE.low <= chunk) & (chunk <= NATIVE.high)).all()
    assert chunk[:, 0].max() > 1.0
    without = replace(NATIVE, numbers=(Number("x"),))
    with one_line_error(PolicyMismatch, "expected numbers within bounds to draw from, those of null/Reach have none"):
        load(policy, {}).act([replace(asked, observation=replace(seen, native=1), action_spec=without)])


@pytest.mark.parametrize("policy", ["random", "untrained"])
def test_a_baseline_that_is_not_told_the_limits_of_joints_says_so_in_a_line(policy, monkeypatch):
    monkeypatch.setattr("robogauntlet.policies.baselines.body_of", lambda task: JOINTS.body)
    asked = query(JOINTS)
    with one_line_error(PolicyMismatch, "run the policy by name"):
        load(policy, {}).act([Query(asked.episode, 0, asked.observation if policy == "untrained" else None)])
