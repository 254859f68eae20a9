"""The scripted oracles of robosuite succeed, also under action noise."""

import numpy as np
import pytest

from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.adapters.robosuite.tasks import WITH_PANDA
from robogauntlet.policies.oracles import scripts
from tests.jobs import mostly_nightly
from tests.policies.playing import steps_to_success

pytestmark = pytest.mark.simulator


# `NutAssembly` has both nuts, the test below it all objects of `PickPlace`, and the adapter's test wipes.
NOW = ["Lift", "Stack", "Door", "NutAssembly", "PickPlaceCan"]


@pytest.mark.parametrize("task", mostly_nightly(sorted(set(WITH_PANDA) - {"PickPlace", "ToolHang"}), NOW))
@pytest.mark.parametrize("seeds", [[0], pytest.param([1, 2, 3], marks=pytest.mark.nightly)], ids=str)
def test_the_oracle_succeeds_within_the_horizon(task, seeds):
    assert None not in steps_to_success(SIMULATOR, task, seeds, noises=(0.0, 0.1))


def test_the_oracle_puts_all_objects_into_their_compartments_where_its_fingers_have_room():
    assert None not in steps_to_success(SIMULATOR, "PickPlace", [0])


def test_the_oracle_stands_the_frame_and_hangs_the_wrench_on_it():  # Noise moves its tip by more than the hole's play.
    assert None not in steps_to_success(SIMULATOR, "ToolHang", [0])


def test_a_nut_that_fell_beside_its_peg_is_taken_again():
    turned = {f"{name}_quaternion": np.array([0.0, 0.0, 0.0, 1.0]) for name in ("square_nut", "round_nut")}
    places = {"square_peg": [0.79, 0.1, -0.06], "round_peg": [0.79, -0.1, -0.06]}
    places |= {"square_nut": [0.73, 0.1, -0.08], "round_nut": [0.79, -0.1, -0.08], "tcp": [0.4, 0.0, 0.1]}
    state = turned | {f"{name}_position": np.array(place) for name, place in places.items()}
    state |= {"tcp_quaternion": np.array([1.0, 0.0, 0.0, 0.0]), "finger_positions": np.array([0.04, 0.04])}
    action = scripts()["robosuite/NutAssembly"]()(state)
    assert action[0] > 0.0
