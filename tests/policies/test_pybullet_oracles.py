"""The scripted oracles of panda-gym succeed, also under action noise."""

import pytest

from robogauntlet.adapters.pybullet import SIMULATOR
from robogauntlet.policies.oracles.pybullet import SCRIPTS
from tests.policies.playing import steps_to_success

SEEDS = range(12)


def test_every_task_has_an_oracle():
    assert set(SCRIPTS) == {f"pybullet/{task}" for task in SIMULATOR.tasks}


@pytest.mark.simulator
@pytest.mark.parametrize("task", SIMULATOR.tasks)
def test_the_oracle_succeeds_within_the_horizon(task):
    assert None not in steps_to_success(SIMULATOR, task, SEEDS)


@pytest.mark.simulator
@pytest.mark.parametrize("task", SIMULATOR.tasks)
def test_the_oracle_recovers_from_noise_in_the_executed_action(task):
    assert steps_to_success(SIMULATOR, task, SEEDS, noises=(0.1,), horizons=2).count(None) <= 1
