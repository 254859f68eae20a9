"""The scripted oracles of robosuite succeed, also under action noise."""

import pytest

from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.policies.oracles.robosuite import SCRIPTS
from robogauntlet.suites.episode import RenderProfile, View
from tests.policies.playing import steps_to_success

pytestmark = pytest.mark.simulator


@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("task", SIMULATOR.tasks)
def test_the_oracle_succeeds_within_the_horizon(task: str, noise: float) -> None:
    simulation = SIMULATOR.open(task, View(image_size=32, render_profile=RenderProfile.FAST))
    script, horizon = SCRIPTS[f"robosuite/{task}"], SIMULATOR.tasks[task].horizon
    steps = [steps_to_success(simulation, script(), seed, horizon, noise) for seed in range(4)]
    simulation.close()
    assert None not in steps
