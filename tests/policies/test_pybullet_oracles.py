"""Each scripted oracle of panda-gym does its task."""

import pytest

from robogauntlet.adapters.pybullet import simulation as adapter
from robogauntlet.policies.oracles.pybullet import SCRIPTS
from robogauntlet.suites.episode import View
from tests.policies.playing import steps_to_success

pytestmark = pytest.mark.simulator
SEEDS = 12


def test_every_task_has_an_oracle():
    assert set(SCRIPTS) == {f"pybullet/{task}" for task in adapter.SIMULATOR.tasks}


@pytest.mark.parametrize("task", adapter.TASKS)
def test_the_oracle_succeeds_within_the_horizon(task):
    simulation = adapter.open(task, View())
    script, horizon = SCRIPTS[f"pybullet/{task}"], adapter.TASKS[task].horizon
    steps = [steps_to_success(simulation, script(), seed, horizon) for seed in range(SEEDS)]
    simulation.close()
    assert None not in steps


@pytest.mark.parametrize("task", adapter.TASKS)
def test_the_oracle_recovers_from_noise_in_the_executed_action(task):
    simulation = adapter.open(task, View())
    script, horizon = SCRIPTS[f"pybullet/{task}"], adapter.TASKS[task].horizon
    steps = [steps_to_success(simulation, script(), seed, 2 * horizon, noise=0.1) for seed in range(SEEDS)]
    simulation.close()
    assert sum(step is not None for step in steps) >= SEEDS - 1
