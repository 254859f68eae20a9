import pytest

from adapters.maniskill import SIMULATOR
from policies.oracles.maniskill import SCRIPTS
from suites.vocabulary import SUCCESS_HOLD, Condition, View


def test_every_task_has_an_oracle():
    assert set(SCRIPTS) == {f"{SIMULATOR.name}/{task}" for task in SIMULATOR.tasks}


@pytest.mark.simulator
@pytest.mark.parametrize("task", SIMULATOR.tasks)
def test_the_oracle_succeeds_within_the_horizon(task):
    simulation = SIMULATOR.open(task, View())
    try:
        # The last two: the farthest goal of Push and the longest turn of Stack among seeds 0 to 99.
        for seed in (0, 1, 2, 81, 75):
            simulation.reset(seed, Condition())
            script, held = SCRIPTS[f"maniskill/{task}"](), 0
            for _ in range(SIMULATOR.tasks[task].horizon):
                action = script(simulation.privileged_state())
                assert (abs(action) <= simulation.action_spec.high).all()
                held = held + 1 if simulation.step(action).success else 0
                if held == SUCCESS_HOLD:
                    break
            assert held == SUCCESS_HOLD, f"seed {seed}"
    finally:
        simulation.close()
