"""The scripted oracles of robosuite succeed, also under action noise."""

import pytest

from robogauntlet.adapters.robosuite.simulation import SIMULATOR
from robogauntlet.adapters.robosuite.tasks import WITH_PANDA
from tests.policies.playing import steps_to_success

pytestmark = pytest.mark.simulator


@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("task", sorted(set(WITH_PANDA) - {"PickPlace"}))
def test_the_oracle_succeeds_within_the_horizon(task, noise):
    assert None not in steps_to_success(SIMULATOR, task, range(4), noise=noise)
