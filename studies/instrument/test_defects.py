"""What the planted defects do to actions, and to which episodes."""

import numpy as np
import pytest

from robogauntlet.suites.episode import Episode, Protocol
from studies.instrument.defects import Defective


def episode(seed):
    return Episode("policy", "", "robosuite/Lift", seed, Protocol(80))


def executed(policy, seed, chunks):
    """What is executed of chunks of two actions, numbered from 1 by their first number."""
    actions = np.arange(1, 2 * chunks + 1)[:, None] * np.eye(1, 7) + np.eye(7)[6]
    answers = [policy._spoil(episode(seed), chunk) for chunk in np.split(actions, chunks)]
    return np.concatenate(answers)


@pytest.mark.parametrize(
    ("delay", "first"), [(0, [1, 2, 3, 4, 5, 6]), (1, [0, 1, 2, 3, 4, 5]), (3, [0, 0, 0, 1, 2, 3])]
)
def test_actions_come_late_by_the_delay_and_the_gripper_is_open_until_then(delay, first):
    policy = Defective(delay=delay)
    for seed in (0, 1):
        late = executed(policy, seed, 3)
        assert late[:, 0].tolist() == first
        assert late[:, 6].tolist() == [-1.0] * delay + [1.0] * (6 - delay)


def test_a_policy_that_does_not_forget_begins_with_actions_of_the_episode_before():
    policy = Defective(delay=1, forgets=False)
    assert executed(policy, 0, 3)[0, 0] == 0
    policy.finish([episode(0)])
    assert executed(policy, 1, 3)[0, 0] == 6


def test_the_gripper_is_flipped_in_a_tenth_of_the_episodes_as_a_whole():
    policy = Defective(flipped=0.1)
    flipped = [executed(policy, seed, 2)[:, 6] for seed in range(30_000, 30_300)]
    assert all(abs(gripper.sum()) == len(gripper) for gripper in flipped)
    assert sum(gripper[0] < 0 for gripper in flipped) == pytest.approx(30, abs=10)
