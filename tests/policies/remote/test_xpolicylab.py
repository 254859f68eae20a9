"""Policy servers of XPolicyLab: one written from the contract, in a thread, and what it answers when it is faulty."""

import numpy as np
import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyMismatch
from robogauntlet.policies.remote.remote_policy import ConnectionLost
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error
from tests.policies.remote.test_client import QUICK, query
from tests.policies.remote.xpolicylab_server import displacements, serving
from tests.remote_servers import answering, speaking

GRIPPER = {"gripper_open": 1, "gripper_closed": 0}
JOINTS = {"joints": 6, **GRIPPER}
TOOL = {"translation_scale": 1.0, "rotation": "quaternion-wxyz", **GRIPPER}


def remote(address, **options):
    return catalog.load("xpolicylab", {"address": address, **QUICK, **options})


def test_an_observation_is_sent_in_their_format_and_targets_of_joints_are_read():
    seen, asked = [], query(joints=6)
    with serving(seen=seen) as address:
        policy = remote(address, **JOINTS, joint_scale=0.5)
        (decision,) = policy.act([asked])
    assert [(kind, trial) for kind, trial, _ in seen] == [
        ("hello", None),
        ("reset", asked.episode.id),
        ("infer", asked.episode.id),
    ]
    observation, shown = seen[2][2]["observation"], asked.observation
    assert observation.keys() == {"data_format_version", "vision", "state", "instruction"}
    assert (observation["data_format_version"], observation["instruction"]) == ("v1.0", "reach the goal")
    for slot, camera in {"cam_head": "third_person", "cam_wrist": "wrist"}.items():
        np.testing.assert_array_equal(observation["vision"][slot]["color"], shown.images[camera])
    np.testing.assert_allclose(observation["state"]["arm_joint_state"], shown.proprioception[:6] / 0.5)
    np.testing.assert_allclose(decision.actions[:, :6], [shown.proprioception[:6] + 0.05] * 4)
    assert list(policy.images_sent(asked)) == ["cam_head", "cam_wrist"]


def test_displacements_of_the_tool_are_read_and_no_state_is_sent():
    seen = []
    with serving(displacements, seen=seen) as address:
        (decision,) = remote(address, **TOOL, cameras={"wrist": "cam_wrist"}, execute=2).act([query()])
    assert seen[-1][2]["observation"].keys() == {"data_format_version", "vision", "instruction"}
    np.testing.assert_allclose(decision.actions, [[0.01, 0, 0, 0, 0, 0, -1]] * 2)


def test_an_episode_is_a_trial_and_is_played_again_with_the_same_row():
    seen, episode = [], Episode("xpl", "digest", "null/Reach", 0, Protocol(12, 8, View(image_size=32)))
    with serving(displacements, seen=seen) as address:
        policy, simulation = remote(address, **TOOL), open_simulation("null/Reach", View(image_size=32))
        first, again = (rollout(simulation, policy, episode) for _ in range(2))
    assert (first.steps, first.actions_hash) == (12, again.actions_hash)
    assert [kind for kind, _, _ in seen] == ["hello", *["reset", "infer", "infer", "infer", "trial_end"] * 2]


def test_a_trial_that_is_lost_ends_its_episode_and_a_lost_end_ends_nothing():
    with serving(displacements, cut=lambda kind, count: count == 4 or kind == "trial_end") as address:
        policy = remote(address, **TOOL)
        policy.act([query(0)])
        with pytest.raises(ConnectionLost, match="was lost during the episode"):
            policy.act([query(8)])
        policy.act([query(0)])
        policy.finish([query().episode])
        policy.act([query(0)])


def test_several_episodes_at_once_are_one_line():
    with serving(displacements) as address:
        policy = remote(address, **TOOL)
        policy.act([query(0), query(0, seed=1)])
        with one_line_error(PolicyError, "expected one episode at a time, .* got several; leave inference: worker"):
            policy.act([query(8)])


WRONG = {
    "units": ({}, r"do not say translation_scale, rotation, rotation_scale, gripper_open, gripper_closed; give each"),
    "poses": ({**TOOL, "actions": ["ee_pose", "ee_joint_state"]}, "option actions: expected .* got ee_pose, which is"),
    "their poses": ({**TOOL, "actions": "left_tcp_pose"}, "option actions: expected .* got left_tcp_pose, which is a"),
}


@pytest.mark.parametrize("name", WRONG)
def test_options_that_are_missing_or_wrong_are_one_line(name):
    options, message = WRONG[name]
    with one_line_error(PolicyMismatch, message):
        remote("xpolicylab://127.0.0.1:1", **options)


FAULTY = {
    "poses": ([{"ee_pose": np.zeros(7)}], "expected 'delta_ee_pose' in an action, got ee_pose; poses are not played"),
    "other keys": ([{"arm": np.zeros(7)}], "expected 'delta_ee_pose' in an action, got arm; set option actions"),
    "no gripper": (
        [{"delta_ee_pose": np.zeros(7)}],
        "expected 'ee_joint_state' in .* delta_ee_pose; set option actions",
    ),
    "none": ([], "expected a list of actions, mappings of arrays, got list"),
    "an array": (np.zeros((4, 8)), "expected a list of actions, mappings of arrays, got dict"),
    "text": ([{"delta_ee_pose": "up", "ee_joint_state": 1.0}] * 2, "expected numbers as 'delta_ee_pose'"),
    "sizes": (
        [{"delta_ee_pose": np.zeros(7), "ee_joint_state": 1.0}, {"delta_ee_pose": np.zeros(6), "ee_joint_state": 1.0}],
        "expected actions of one size, got several",
    ),
    "too few numbers": (
        [{"delta_ee_pose": np.zeros(6), "ee_joint_state": 1.0}],
        r"expected 'delta_ee_pose, ee_joint_state' of shape \(n, 8\), n from 1 to 1000, got \(1, 7\)",
    ),
}


@pytest.mark.parametrize("name", FAULTY)
def test_faulty_actions_are_one_line(name):
    actions, message = FAULTY[name]
    with serving(lambda *_: actions) as address, one_line_error(PolicyMismatch, message):
        remote(address, **TOOL).act([query()])


def test_one_action_alone_is_a_chunk_of_one():
    with serving(lambda *seen: displacements(*seen)[0]) as address:
        (decision,) = remote(address, **TOOL).act([query()])
    assert decision.actions.shape == (1, 7)


def test_the_servers_error_and_another_protocol_are_one_line():
    def fails(*_):
        raise RuntimeError("CUDA out of memory")

    with serving(fails) as address, one_line_error(PolicyError, "got an error: CUDA out of memory"):
        remote(address, **TOOL).act([query()])
    said = "expected a message 'hello_ack' with a mapping, got 'None' with NoneType"
    with speaking(answering({})) as address, one_line_error(PolicyError, said):
        remote(address, **TOOL)


def test_it_is_known_by_its_address_or_its_identity_and_a_server_that_starts_again_is_the_same():
    kind = catalog.find("xpolicylab")
    with serving() as first, serving() as second:
        by_address = {catalog.digest("xpolicylab", {"address": address, **JOINTS}) for address in (first, second)}
        assert "says nothing of itself" in kind.contact({"address": first, **JOINTS}).warning
        named = {"address": first, **JOINTS, "identity": "pi0@1"}
        known = kind.contact(named).options
        assert kind.contact({**known, "address": second}).options["expected_metadata"] == known["expected_metadata"]
        with_identity = {kind.digest(named), kind.digest_without_start(named)}
    assert (len(by_address), len(with_identity)) == (2, 1)
