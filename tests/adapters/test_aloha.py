"""ALOHA's tasks are played as gym-aloha plays them, and seen as its policies see them."""

from contextlib import closing

import numpy as np
import pytest

from robogauntlet.adapters.gymnasium import SIMULATOR
from robogauntlet.suites.episode import CAMERAS, View
from tests.policies.playing import steps_to_success

pytestmark = pytest.mark.simulator
START = np.array([0.0, -0.96, 1.16, 0.0, -0.3, 0.0, 0.1])
"""Of an arm: joints (rad), and gripper from 0, closed, to 1, open."""


def test_a_step_is_the_environments_own_but_for_pictures_that_nobody_asked_for():
    gymnasium = pytest.importorskip("gymnasium")
    pytest.importorskip("gym_aloha")
    theirs = gymnasium.make("gym_aloha/AlohaTransferCube-v0", obs_type="pixels_agent_pos").unwrapped
    theirs.reset(seed=5)
    wanted = np.concatenate([START, START]).astype(np.float32)
    wanted[[3, 6, 7, 13]] += [0.2, 0.6, -0.3, 0.9]
    with closing(SIMULATOR.open("AlohaTransferCube-v0", View(CAMERAS[:1], 640))) as ours:
        ours.reset(5)
        action = wanted.astype(np.float64).reshape(2, 7)
        action[:, -1] = 1.0 - 2.0 * action[:, -1]
        for _ in range(3):
            seen, reward, *_ = theirs.step(wanted)
            assert ours.step(action.ravel()).reward == reward
        observation = ours.observe()
    numbers = observation.proprioception.reshape(2, 7) * [*[1.0] * 6, -0.5] + [*[0.0] * 6, 0.5]
    np.testing.assert_allclose(numbers.ravel(), seen["agent_pos"], atol=1e-12)
    middle = observation.images["third_person"][80:560].astype(int)
    differing = np.abs(middle - seen["pixels"]["top"]).max(axis=2)
    assert (differing > 2).mean() < 1e-3


@pytest.mark.parametrize("task", ["AlohaTransferCube-v0", "AlohaInsertion-v0"])
def test_the_oracle_succeeds_within_the_horizon(task):
    assert None not in steps_to_success(SIMULATOR, task, [0])
