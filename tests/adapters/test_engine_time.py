"""The engine of a simulation is measured alone."""

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.suites.episode import View

TASKS = ("maniskill/StackCube-v1", "metaworld/reach-v3", "pybullet/PandaPush-v3", "robosuite/Stack")


@pytest.mark.simulator
@pytest.mark.parametrize("task", TASKS)
def test_measuring_the_engine_leaves_the_state_as_it_is(task):
    simulation = catalog.open_simulation(task, View())
    simulation.reset(3)
    simulation.step(simulation.action_spec.high)
    before = simulation.state_hash()
    assert simulation.engine_time() > 0
    assert simulation.state_hash() == before
    simulation.close()
