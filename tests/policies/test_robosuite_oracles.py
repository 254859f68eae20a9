"""The scripted oracles of robosuite succeed, also when what is executed is not quite what they ask for."""

import numpy as np
import pytest

from adapters.robosuite import SIMULATOR
from policies.oracles.robosuite import SCRIPTS
from suites.vocabulary import SUCCESS_HOLD, Condition, RenderProfile, View

pytestmark = pytest.mark.simulator


@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("task", SIMULATOR.tasks)
def test_the_oracle_succeeds_within_the_horizon(task: str, noise: float) -> None:
    """`noise` is the deviation of the executed action, as a share of its range."""
    simulation = SIMULATOR.open(task, View(image_size=32, render_profile=RenderProfile.FAST))
    spec = simulation.action_spec
    failures = []
    for seed in range(4):
        generator = np.random.default_rng(seed)
        simulation.reset(seed, Condition())
        script, held = SCRIPTS[f"robosuite/{task}"](), 0
        for _ in range(SIMULATOR.tasks[task].horizon):
            action = script(simulation.privileged_state())
            action[:6] += noise * spec.high[:6] * generator.standard_normal(6)
            held = held + 1 if simulation.step(np.clip(action, spec.low, spec.high)).success else 0
            if held == SUCCESS_HOLD:
                break
        else:
            failures.append(seed)
    simulation.close()
    assert not failures
