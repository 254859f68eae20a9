"""Servers of vLLM-Omni: openpi's protocol at a path, with a configuration, sessions and seeds."""

import numpy as np
import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyMismatch
from robogauntlet.policies.references import read_reference
from robogauntlet.policies.remote.remote_policy import ConnectionLost
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error
from tests.policies.remote.test_client import QUICK, query
from tests.policies.remote.vllm_omni_server import CONFIG, actions, serving

CHUNK = np.linspace(-0.5, 0.5, 56, dtype=np.float32).reshape(8, 7)


def remote(address, **options):
    return catalog.load("openpi", {"address": address, **QUICK, "image_size": 32, **options})


@pytest.mark.parametrize(
    ("answer", "options"),
    [
        (CHUNK, {}),
        (CHUNK[None], {}),
        ({"actions": CHUNK}, {}),
        ({"gripper": CHUNK[None, :, 6:], "arm": CHUNK[None, :, :6]}, {"actions": ["arm", "gripper"]}),
    ],
)
def test_arrays_and_mappings_of_arrays_are_chunks(answer, options):
    with serving(infer=lambda _: answer) as address:
        (decision,) = remote(address, **options).act([query()])
    np.testing.assert_array_equal(decision.actions, CHUNK)


def test_an_observation_has_its_keys_a_session_and_a_seed():
    seen, keys = [], {"third_person": "observation.images.base_0_rgb", "wrist": "observation.images.left_wrist_0_rgb"}
    with serving(seen=seen) as address:
        remote(address, cameras=keys, proprioception="state").act([query()])
    ((observation, reset),) = seen
    assert observation.keys() == {*keys.values(), "state", "prompt", "session_id", "seed"}
    assert reset


def test_each_episode_is_a_session_and_each_step_has_the_same_seed_again():
    seen = []
    asked = [query(0), query(8), query(0, seed=1), query(8, seed=1), query(0), query(0), query(8)]
    with serving(seen=seen) as address:
        policy = remote(address)
        for one in asked:
            policy.act([one])
    assert [reset for _, reset in seen] == [True, False, True, False, True, True, False]
    sessions, seeds = ([observation[key] for observation, _ in seen] for key in ("session_id", "seed"))
    assert len(set(sessions)) == 4
    assert (seeds[4:], len(set(seeds))) == ([seeds[0], seeds[0], seeds[1]], 4)


def test_an_episode_is_played_and_again_with_the_same_row():
    episode = Episode("pi0", "digest", "null/Reach", 0, Protocol(12, 8, View(image_size=32)))
    with serving() as address:
        policy, simulation = remote(address), open_simulation("null/Reach", View(image_size=32))
        first, again = (rollout(simulation, policy, episode) for _ in range(2))
    assert (first.steps, first.actions_hash) == (12, again.actions_hash)


def test_a_model_without_sessions_gets_none_and_goes_on_after_a_lost_connection():
    seen = []
    with serving({**CONFIG, "needs_session_id": False}, seen=seen, cut=lambda count: count == 2) as address:
        policy = remote(address)
        for step in (0, 8):
            policy.act([query(step)])
    assert [("session_id" in observation, "seed" in observation) for observation, _ in seen] == [(False, True)] * 2


def test_a_session_that_is_lost_ends_its_episode():
    with serving(cut=lambda count: count == 2) as address:
        policy = remote(address)
        policy.act([query(0)])
        with pytest.raises(ConnectionLost, match="was lost during the episode"):
            policy.act([query(8)])
        policy.act([query(0)])  # it is played again


def test_sessions_of_several_episodes_at_once_are_one_line():
    with serving() as address:
        policy = remote(address)
        policy.act([query(0), query(0, seed=1)])
        with one_line_error(PolicyError, "expected one episode at a time, .* got several; leave inference: worker"):
            policy.act([query(8)])


WRONG = {
    "no size": ({}, {"image_size": None}, r"expected option image_size: \[32, 32\], as .* says, got none"),
    "a size": ({"image_resolution": [180, 320]}, {}, r"expected option image_size: \[180, 320\], as .* says, got 32"),
    "another shape": ({}, {"image_size": [32, 64]}, r"expected option image_size: \[32, 32\], .* got \[32, 64\]"),
    "two cameras": ({"n_external_cameras": 2}, {}, "expected 2 external cameras, .* got tasks show one"),
    "no camera": ({}, {"cameras": {"wrist": "w"}}, "expected 1 external cameras, .* got none; give third_person"),
    "no wrist": ({}, {"cameras": {"third_person": "i"}}, "expected a wrist camera, .* got none; give wrist by option"),
    "stereo": ({"needs_stereo_camera": True}, {}, "expected stereo cameras, .* got a camera, which is what tasks show"),
    "targets": (
        {"action_space": "joint_position"},
        {},
        "expected motions of the tool, got the action_space joint_position; give options joints",
    ),
    "poses": ({"action_space": "cartesian_position"}, {}, "expected motions .* action_space cartesian_position"),
    "velocities": (
        {"action_space": "joint_velocity"},
        {"joints": 7, "gripper_open": 0, "gripper_closed": 1},
        "expected targets of joints, as options say, got the action_space joint_velocity; give .* velocity_scale",
    ),
    "a space of tools": (
        {"action_space": "delta_eef"},
        {"joints": 7, "gripper_open": 0, "gripper_closed": 1},
        "expected targets of joints, .* got the action_space delta_eef",
    ),
    "malformed": ({"image_resolution": 224}, {}, "expected a policy_server_config as metadata: image_resolution"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_configuration_that_the_options_do_not_meet_is_one_line(name):
    config, options, message = WRONG[name]
    with serving({**CONFIG, **config}) as address, one_line_error(PolicyMismatch, message):
        remote(address, **options)


@pytest.mark.parametrize(("space", "scale"), [("joint_position", {}), ("joint_velocity", {"velocity_scale": 3.0})])
def test_numbers_of_joints_and_fields_that_are_unknown_or_missing_are_taken(space, scale):
    of_joints = {"joints": 7, "gripper_open": 0, "gripper_closed": 1, "cameras": {"third_person": "image"}}
    config = {"needs_session_id": False, "action_space": space, "action_keys": ["actions"], "max_cameras": 3}
    with serving(config, lambda _: np.zeros((1, 8), np.float32)) as address:
        (decision,) = remote(address, **of_joints, **scale).act([query(joints=7)])
    np.testing.assert_array_equal(decision.actions, [[0, 0, 0, 0, 0, 0, 0, -1]])


def test_a_model_that_is_no_robot_policy_and_errors_of_one_are_one_line():
    said = "got an error: Robot policy not available: its model has no policy_server_config; serve a robot policy"
    with serving(None) as address, one_line_error(PolicyError, said):
        remote(address)
    said = "got an error: Internal inference error; see the server's log, and whether options cameras, .* expects"
    with serving(infer=lambda seen: actions(seen)["none"]) as address, one_line_error(PolicyError, said):
        remote(address).act([query()])


def test_it_is_known_by_its_address_since_a_configuration_names_no_checkpoint():
    with serving() as first, serving() as second:
        addresses = [read_reference(address).options["address"] for address in (first, second)]
        digests = {catalog.digest("openpi", {"address": address, "image_size": 32}) for address in addresses}
        warning = catalog.find("openpi").contact({"address": first, "image_size": 32}).warning
    assert len(digests) == 2
    assert "its server names no checkpoint" in warning
