"""LIBERO's scripted oracles succeed, also under action noise."""

import pytest

from robogauntlet.adapters.libero import SIMULATOR
from robogauntlet.adapters.libero.assets import package_folder
from robogauntlet.policies.oracles.libero import SCRIPTS
from tests.policies.playing import steps_to_success

PLAYED = ("spatial-8-next-to-plate", "object-3-bbq-sauce", "goal-7-turn-on-stove")
"""One task of each suite; for the others see docs/libero.md."""


def test_every_script_is_for_an_existing_task():
    assert {f"libero/{task}" for task in SIMULATOR.tasks} >= SCRIPTS.keys()
    assert len(SCRIPTS) == 21


@pytest.mark.simulator
@pytest.mark.skipif(package_folder() is None, reason="LIBERO is not installed here: robogauntlet env create libero")
@pytest.mark.parametrize("task", PLAYED)
@pytest.mark.parametrize(("seed", "noise"), [(0, 0.0), (11, 0.1)])
def test_the_oracle_succeeds_within_the_horizon(task, seed, noise):
    assert None not in steps_to_success(SIMULATOR, task, [seed], noise=noise)
