"""Each scripted oracle of panda-gym does its task."""

import numpy as np
import pytest

from adapters.pybullet import simulation as adapter
from policies.oracles.pybullet import SCRIPTS
from suites.vocabulary import SUCCESS_HOLD, Condition, View

pytestmark = pytest.mark.simulator
SEEDS = 12


def steps_to_success(simulation, script, seed, horizon, noise=0.0):
    """Control steps until the predicate has held for long enough, or None."""
    simulation.reset(seed, Condition())
    generator = np.random.default_rng(seed)
    held = 0
    for step in range(horizon):
        action = script(simulation.privileged_state())
        assert np.all(np.abs(action) <= simulation.action_spec.high + 1e-12)
        action[:3] += generator.normal(0.0, noise, 3)
        held = held + 1 if simulation.step(action).success else 0
        if held == SUCCESS_HOLD:
            return step + 1
    return None


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
    steps = [steps_to_success(simulation, script(), seed, 2 * horizon, noise=0.005) for seed in range(SEEDS)]
    simulation.close()
    assert sum(step is not None for step in steps) >= SEEDS - 1
