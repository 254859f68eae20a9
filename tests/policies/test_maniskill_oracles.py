"""ManiSkill's scripted oracles succeed."""

import pytest

from robogauntlet.adapters.maniskill import SIMULATOR
from robogauntlet.policies.oracles import scripts
from tests.policies.playing import steps_to_success

TASKS = [task for task, described in SIMULATOR.tasks.items() if not described.native]


def test_every_task_of_a_panda_has_an_oracle():
    assert len(TASKS) == 13
    assert {f"{SIMULATOR.name}/{task}" for task in TASKS} <= scripts().keys()


@pytest.mark.simulator
@pytest.mark.parametrize("task", TASKS)
# By day the farthest goal of Push and the longest turn of Stack among seeds 0 to 99.
@pytest.mark.parametrize("seeds", [[81, 75], pytest.param([0, 1, 2], marks=pytest.mark.nightly)], ids=str)
def test_the_oracle_succeeds_within_the_horizon(task, seeds):
    assert None not in steps_to_success(SIMULATOR, task, seeds)
