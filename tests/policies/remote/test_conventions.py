"""Other conventions: turned images, Euler angles and quaternions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from robogauntlet.policies.contract import PolicyMismatch
from robogauntlet.policies.remote.conversion import decode_chunk, turn_image
from robogauntlet.policies.remote.server_options import read_options

SEEDS = st.integers(0, 2**32 - 1)
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
    assert bytes(turn_image(server_options(turn=turn), image)[..., 0]) == corners.encode()


def test_options_added_later_do_not_change_the_hash_of_policies_without_them():
    assert "turn" not in server_options().declaration()
    assert "rotation" not in server_options().declaration()
    digests = {server_options(**options).digest("x") for options in ({}, {"turn": "half"}, {"rotation": "euler"})}
    assert len(digests) == 3
