"""Other conventions: turned images, Euler angles and quaternions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import Moves, Observation
from robogauntlet.policies.contract import PolicyError, PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote.conversion import decode_chunk, encode_observation, turn_image
from robogauntlet.policies.remote.msgpack_numpy import PackingError
from robogauntlet.policies.remote.protocol import as_message, query_in
from robogauntlet.policies.remote.server_options import read_options
from robogauntlet.suites.episode import CAMERAS, Episode, Protocol
from tests.errors import one_line_error

SEEDS = st.integers(0, 2**32 - 1)
EPISODE = Episode("p", "p", "null/Reach", 0, Protocol(8))
IMAGES = dict.fromkeys(CAMERAS, np.zeros((8, 8, 3), np.uint8))
AS_WRITTEN = {
    "axis-angle": lambda turns: turns.as_rotvec(),
    "euler": lambda turns: turns.as_euler("xyz"),
    "quaternion-xyzw": lambda turns: turns.as_quat(),
    "quaternion-wxyz": lambda turns: turns.as_quat(scalar_first=True),
}


def server_options(**options):
    return read_options({"address": "a:1", **options})


@pytest.mark.parametrize("rotation", AS_WRITTEN)
@given(SEEDS)
def test_a_rotation_is_the_same_in_every_representation(rotation, seed):
    turns = Rotation.random(5, rng=np.random.default_rng(seed))
    rows = np.concatenate([np.ones((5, 3)), AS_WRITTEN[rotation](turns), np.ones((5, 1))], axis=1)
    chunk = decode_chunk(server_options(rotation=rotation), {"actions": rows})
    assert chunk.shape == (5, 7)
    assert (Rotation.from_rotvec(chunk[:, 3:6]) * turns.inv()).magnitude().max() < 1e-7
    np.testing.assert_array_equal(chunk[:, [0, 1, 2, 6]], np.ones((5, 4)))


def test_euler_angles_turn_about_the_fixed_axes_x_then_y_then_z_and_are_scaled_before():
    rows = np.array([[0.0, 0.0, 0.0, 0.2, 0.4, 0.6, 1.0]])
    chunk = decode_chunk(server_options(rotation="euler", rotation_scale=0.5), {"actions": rows})
    x, y, z = (Rotation.from_rotvec(angle * axis) for angle, axis in zip((0.1, 0.2, 0.3), np.eye(3), strict=True))
    np.testing.assert_allclose(chunk[0, 3:6], (z * y * x).as_rotvec(), atol=1e-12)


def test_both_signs_of_a_quaternion_are_the_same_turn_of_no_more_than_half_a_turn():
    quaternion = Rotation.from_rotvec([0.1, 0.0, 0.2]).as_quat()
    rows = np.array([[0, 0, 0, *sign * quaternion, 1] for sign in (1, -1)], dtype=float)
    chunk = decode_chunk(server_options(rotation="quaternion-xyzw"), {"actions": rows})
    np.testing.assert_allclose(chunk[:, 3:6], [[0.1, 0.0, 0.2]] * 2, atol=1e-12)


def test_columns_choose_the_four_numbers_of_a_quaternion():
    rows = np.array([[9.0, 0.0, 0.0, 0.0, 1.0, 0.5]])
    options = {"rotation": "quaternion-wxyz", "columns": [None, None, 5, 4, 1, 2, 3, 0], "gripper_closed": 9}
    np.testing.assert_allclose(decode_chunk(server_options(**options), {"actions": rows}), [[0, 0, 0.5, 0, 0, 0, 1]])


def test_numbers_that_are_no_quaternion_are_refused_in_one_line():
    rows = np.zeros((2, 8))
    rows[0, 6] = 1.0
    with pytest.raises(PolicyMismatch, match=r"^expected quaternions of length 1 in 'actions', got length 0 in row 1;"):
        decode_chunk(server_options(rotation="quaternion-xyzw"), {"actions": rows})


@pytest.mark.parametrize(
    ("turn", "corners"), [("none", "abcd"), ("half", "dcba"), ("left-right", "badc"), ("upside-down", "cdab")]
)
def test_images_are_turned_and_mirrored(turn, corners):
    image = np.frombuffer(b"abcd", np.uint8).reshape(2, 2, 1).repeat(3, axis=2)
    assert bytes(turn_image(server_options(turn=turn), "wrist", image)[..., 0]) == corners.encode()


def test_each_camera_may_have_a_turn_of_its_own():
    image = np.frombuffer(b"abcd", np.uint8).reshape(2, 2, 1).repeat(3, axis=2)
    options = server_options(turn={"third_person": "left-right"})
    turned = {camera: bytes(turn_image(options, camera, image)[..., 0]) for camera in CAMERAS}
    assert turned == {"third_person": b"badc", "wrist": b"abcd"}
    same, none = dict.fromkeys(CAMERAS, "half"), dict.fromkeys(CAMERAS, "none")
    assert server_options(turn=same).digest("x") == server_options(turn="half").digest("x")
    assert server_options(turn=none).digest("x") == server_options().digest("x") != options.digest("x")


@pytest.mark.parametrize(
    ("turn", "match"),
    [
        ("left", "turn: expected none, half, left-right or upside-down, or one for each camera, got 'left'$"),
        (90, "turn: expected none, .*, got 90$"),
        ({}, "turn: expected none, .*, got {}$"),
        ({"wrist": "left"}, "turn: expected none, .*, got {'wrist': 'left'}$"),
        ({"wrist": ["half"]}, "turn: expected none, .*"),
        ({"front": "half"}, "turn: expected some of third_person, wrist, got 'front'$"),
    ],
)
def test_a_turn_that_is_none_is_one_line(turn, match):
    with one_line_error(PolicyError, match):
        read_options({"address": "a:1", "turn": turn})


def test_proprioception_may_have_several_keys_and_a_chunk_those_of_its_columns():
    options = server_options(proprioception={"arm": [0, 1, 2], "hand": [7, 6]}, actions=["arm", "hand"])
    message = encode_observation(options, Observation(IMAGES, np.arange(8.0), "reach"), EPISODE)
    np.testing.assert_array_equal(message["arm"], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(message["hand"], [7.0, 6.0])
    chunk = decode_chunk(options, {"hand": np.ones((3, 1)), "arm": np.zeros((3, 6)), "more": 1})
    np.testing.assert_array_equal(chunk, [[0.0] * 6 + [1.0]] * 3)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"proprioception": {}}, "proprioception: expected a key, or keys with columns .*, got {}"),
        ({"proprioception": {"arm": []}}, "proprioception: expected a key, or keys with columns .*, got {'arm': ..}"),
        ({"proprioception": {"arm": [True]}}, "proprioception: expected a key, or keys with columns .*True"),
        ({"proprioception": 5}, "proprioception: expected a key, or keys with columns .*, got 5"),
        ({"proprioception": {"prompt": [0]}}, "expected another key for each part of the observation, got .*prompt"),
        ({"proprioception": {"arm": [-1]}}, "proprioception.*expected .*, got .*-1"),
        ({"proprioception": {"arm": [0, 8]}}, "option proprioception: expected columns below 8, got 8"),
        ({"actions": []}, "actions: expected a key, or a list of different keys, got .."),
        ({"actions": ["arm", "hand"]}, "expected 'arm' in the answer, got actions; set option actions"),
    ],
)
def test_keys_that_do_not_fit_are_one_line(given, match):
    with one_line_error(PolicyError, match):
        options = server_options(**given)
        encode_observation(options, Observation(IMAGES, np.arange(8.0), "reach"), EPISODE)
        decode_chunk(options, {"actions": np.zeros((1, 7))})


def test_options_added_later_do_not_change_the_hash_of_policies_without_them():
    assert "turn" not in server_options().declaration()
    assert "rotation" not in server_options().declaration()
    digests = {server_options(**options).digest("x") for options in ({}, {"turn": "half"}, {"rotation": "euler"})}
    assert len(digests) == 3


SO101 = {"convention": "so101"}


@given(SEEDS)
def test_degrees_of_an_so101_are_sent_and_read_back_as_radians(seed):
    state = np.append(np.random.default_rng(seed).uniform(-1.5, 1.5, 5), 0.5)
    observation = Observation({"third_person": np.zeros((8, 8, 3), np.uint8)}, state, "stack", of_joints=True)
    options = server_options(**SO101, cameras={"third_person": "image"})
    sent = encode_observation(options, observation, Episode("p", "p", "so101/Stack", 0, Protocol(8)))
    np.testing.assert_allclose(sent["observation/state"], [*np.degrees(state[:5]), 25.0])
    answer = {"actions": sent["observation/state"][None]}
    np.testing.assert_allclose(decode_chunk(options, answer), state[None])


def test_other_joints_have_a_scale_each_and_columns_of_their_own():
    options = {"joints": 2, "joint_scale": [0.1, 0.01], "columns": [2, 1, 0]}
    rows = np.array([[1.0, 50.0, 3.0]])
    np.testing.assert_allclose(
        decode_chunk(server_options(**options, gripper_open=0.0, gripper_closed=1.0), {"actions": rows}),
        [[0.3, 0.5, 1.0]],
    )


def test_two_arms_have_their_joints_and_grippers_one_after_the_other():
    options = {"joints": 2, "joint_scale": [0.1, 0.01], "arms": 2, "gripper_open": 0.0, "gripper_closed": 1.0}
    options = server_options(**options, cameras={"third_person": "image"})
    state = np.array([0.3, 0.5, 1.0, -0.3, -0.5, -1.0])
    observation = Observation({"third_person": np.zeros((8, 8, 3), np.uint8)}, state, "lift", of_joints=True)
    sent = encode_observation(options, observation, EPISODE)
    np.testing.assert_allclose(sent["observation/state"], [3.0, 50.0, 1.0, -3.0, -50.0, 0.0])
    np.testing.assert_allclose(decode_chunk(options, {"actions": sent["observation/state"][None]}), state[None])
    assert options.action_dim == 6


def test_alohas_grippers_are_sent_from_closed_to_open_and_the_middle_of_its_images():
    options = server_options(convention="aloha", cameras={"third_person": "image"}, image_size=[48, 64])
    images = {"third_person": np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)}
    state = np.array([*[0.1] * 6, 1.0, *[-0.2] * 6, -0.5])
    sent = encode_observation(options, Observation(images, state, "lift", of_joints=True), EPISODE)
    np.testing.assert_array_equal(sent["image"], images["third_person"][8:56])
    np.testing.assert_allclose(sent["observation/state"], [*[0.1] * 6, 0.0, *[-0.2] * 6, 0.75])
    np.testing.assert_allclose(decode_chunk(options, {"actions": sent["observation/state"][None]}), state[None])
    assert (options.action_dim, options.wishes.image_size) == (14, 64)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"convention": "aloha", "columns": [0] * 7}, "columns: expected 14 places for joints and gripper, got 7"),
        ({"convention": "aloha", "resize": "pad"}, "expected no resize, which convention aloha sets"),
        ({"joints": 5, "rotation": "euler"}, "expected no rotation beside joints, whose targets are no motion"),
        ({"joints": 5, "joint_scale": [1.0, 2.0]}, r"joint_scale: .* one for each of joints, got \[1.0, 2.0\]"),
        ({"joints": 5, "joint_scale": 0.0}, r"joint_scale: expected a number other than 0"),
        ({**SO101, "joints": 6}, "expected no joints, which convention so101 sets"),
        ({**SO101, "columns": [0] * 7}, "columns: expected 6 places for joints and gripper, got 7"),
        ({**SO101, "rotation": "euler"}, "expected no rotation beside joints"),
        ({"joint_scale": 0.5}, "joint_scale: expected joints, their number, beside it"),
        ({"joints": 0}, "joints: "),
        ({"arms": 2}, "arms: expected joints, their number, beside it, got 2 without"),
        ({"joints": 2, "arms": 2, "columns": [0, 1, 2]}, "columns: expected 6 places for joints and gripper, got 3"),
        ({"joints": 5, "gripper_open": 100.0}, "expected gripper_closed beside joints, whose gripper has no common"),
        ({"joints": 5}, "expected gripper_closed and gripper_open beside joints"),
    ],
)
def test_options_of_joints_that_do_not_fit_are_one_line(options, says):
    with one_line_error(PolicyError, says):
        server_options(**options)


NATIVE = Observation({"third_person": np.zeros((8, 8, 3), np.uint8)}, np.array([3.0, 200.0]), "push", native=3)
PUSHT = Episode("p", "p", "gymnasium/PushT-v0", 0, Protocol(8))


def test_native_numbers_are_sent_and_read_as_they_are():
    options = server_options(convention="native", cameras={"third_person": "image"})
    sent = encode_observation(options, NATIVE, PUSHT)
    assert sent["observation/state"].tolist() == [3.0, 200.0]
    rows = np.array([[1.0, 300.0, -7.5]])
    np.testing.assert_array_equal(decode_chunk(options, {"actions": rows}, 3), rows)
    with one_line_error(
        PolicyMismatch, r"expected 'actions' of shape \(n, 2\).* got \(1, 3\); choose .* by option columns"
    ):
        decode_chunk(options, {"actions": rows}, 2)
    chosen = server_options(convention="native", cameras={"third_person": "image"}, columns=[2, None])
    np.testing.assert_array_equal(decode_chunk(chosen, {"actions": rows}, 2), [[-7.5, 0.0]])


@pytest.mark.parametrize("option", [{"joints": 2}, {"gripper_open": 0.0}, {"translation_scale": 0.1}, {"arms": 2}])
def test_options_of_robots_are_refused_beside_native_numbers_in_one_line(option):
    (name,) = option
    with one_line_error(PolicyError, f"expected no {name} beside convention native"):
        server_options(convention="native", **option)


@pytest.mark.parametrize(
    ("options", "observation", "says"),
    [
        ({}, NATIVE, "expected a task with motions of the tool, .* has numbers of the environment's own"),
        (SO101, NATIVE, "expected a task with 6 numbers of joints, .* has numbers of the environment's own"),
        (
            {"convention": "native"},
            replace(NATIVE, native=None),
            "with numbers of the environment's own, .* has motions",
        ),
    ],
)
def test_policies_of_robots_and_of_native_numbers_refuse_each_others_tasks(options, observation, says):
    given = server_options(**options, cameras={"third_person": "image"})
    with one_line_error(PolicyMismatch, says):
        encode_observation(given, observation, PUSHT)


@pytest.mark.parametrize("spec", [{"action_dim": None}, {"action_dim": 3, "moves": Moves.NATIVE}])
def test_an_observation_of_native_numbers_passes_a_server_of_robogauntlet_unchanged(spec):
    asked = Query(PUSHT, 3, NATIVE)
    received = query_in(as_message(asked, []), PUSHT, 3, PolicySpec(PolicyInput.OBSERVATION, 8, **spec)).observation
    assert (received.native, received.action_dim, received.of_joints) == (3, 3, False)
    assert received.proprioception.tolist() == [3.0, 200.0]


@pytest.mark.parametrize("number", [0, "2", 10**9])
def test_a_number_of_native_numbers_that_is_none_is_refused_in_one_line(number):
    message = {**as_message(Query(PUSHT, 3, NATIVE), []), "robogauntlet/native": number}
    with one_line_error(PackingError, "expected 1 to 10000 numbers of an action as robogauntlet/native, got"):
        query_in(message, PUSHT, 3, PolicySpec(PolicyInput.OBSERVATION, 8, None))


@pytest.mark.parametrize(("options", "of_joints", "numbers"), [(SO101, False, 8), ({}, True, 6), (SO101, True, 7)])
def test_a_task_of_other_numbers_is_refused_in_one_line(options, of_joints, numbers):
    shown = Observation({"third_person": np.zeros((8, 8, 3), np.uint8)}, np.zeros(numbers), "go", of_joints)
    given = server_options(**options, cameras={"third_person": "image"})
    with one_line_error(
        PolicyMismatch, "expected a task with .*, so101/Stack has .*; see options convention, joints and arms"
    ):
        encode_observation(given, shown, Episode("p", "p", "so101/Stack", 0, Protocol(8)))


@pytest.mark.parametrize("action_dim", [None, 6])
def test_an_observation_of_joints_passes_a_server_of_robogauntlet_unchanged(action_dim):
    spec = PolicySpec(PolicyInput.OBSERVATION, 8, action_dim)
    episode = Episode("p", "p", "so101/Stack", 0, Protocol(8))
    images = {"third_person": np.zeros((8, 8, 3), np.uint8)}
    asked = Query(episode, 3, Observation(images, np.arange(6.0), "stack", of_joints=True))
    received = query_in(as_message(asked, []), episode, 3, spec).observation
    assert received.of_joints
    assert received.action_dim == 6
    np.testing.assert_array_equal(received.proprioception, np.arange(6.0))
