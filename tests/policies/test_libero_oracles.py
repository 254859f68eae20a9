"""LIBERO's scripted oracles succeed, also under action noise."""

import numpy as np
import pytest

from robogauntlet.adapters.libero import SIMULATOR
from robogauntlet.policies.oracles.libero import GRASPS, SCRIPTS, TURNS, InTurn, free_grasp
from tests.policies.playing import steps_to_success

PLAYED = (
    "spatial-8-next-to-plate",
    "object-1-cream-cheese",
    "goal-7-turn-on-stove",
    "10-3-kitchen4-put-black-bowl-in-bottom-drawer-cabinet-close",
)
"""One task of each suite; for the others see docs/simulators.md."""
MIDDLE = np.array([0.5, 0.0, 0.03])


def test_every_script_is_for_an_existing_task():
    assert {f"libero/{task}" for task in SIMULATOR.tasks} >= SCRIPTS.keys()
    assert len(SCRIPTS) == 3 * 34


def test_scripts_are_played_in_turn_and_the_last_one_goes_on():
    class Step:
        def __init__(self, number):
            self.number = number

        def __call__(self, state):
            return self.number

        def done(self, state):
            return state["finished"] >= self.number

    script = InTurn(Step(1), Step(2), last=Step(3))
    assert [script({"finished": finished}) for finished in (0, 1, 0, 2, 3, 0)] == [1, 2, 2, 3, 3, 3]


def test_a_can_is_grasped_with_the_fingers_away_from_its_neighbour():
    state = {"can_1_position": MIDDLE, "can_2_position": np.array([0.5, 0.09, 0.03])}
    yaw, _ = free_grasp(state, "can_1", MIDDLE, GRASPS["alphabet_soup"], TURNS)
    assert yaw != 0.0
    assert free_grasp({"can_1_position": MIDDLE}, "can_1", MIDDLE, GRASPS["alphabet_soup"], TURNS)[0] == 0.0


def test_a_box_is_grasped_away_from_a_tall_neighbour():
    state = {"box_1_position": MIDDLE, "carton_1_position": np.array([0.56, 0.1, 0.09])}
    _, place = free_grasp(state, "box_1", MIDDLE, GRASPS["butter"], [0.0])
    assert place[0] < 0.0


@pytest.mark.simulator
@pytest.mark.apart("libero")
@pytest.mark.parametrize("task", PLAYED)
@pytest.mark.parametrize(("seed", "noise"), [(0, 0.0), (11, 0.1)])
def test_the_oracle_succeeds_within_the_horizon(task, seed, noise):
    assert None not in steps_to_success(SIMULATOR, task, [seed], noises=(noise,))
