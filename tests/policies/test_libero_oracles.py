"""LIBERO's scripted oracles succeed, also under action noise."""

import pytest

from robogauntlet.adapters.libero import SIMULATOR
from robogauntlet.adapters.libero.assets import package_folder
from robogauntlet.policies.oracles.libero import SCRIPTS
from robogauntlet.suites.episode import RenderProfile, View
from tests.policies.playing import steps_to_success

PLAYED = ("spatial-8-next-to-plate", "object-3-bbq-sauce", "goal-7-turn-on-stove")
"""One of each suite: the others were played by hand, see docs/libero.md."""


def test_every_script_is_for_a_task_that_there_is() -> None:
    assert {f"libero/{task}" for task in SIMULATOR.tasks} >= SCRIPTS.keys()
    assert len(SCRIPTS) == 21


@pytest.mark.simulator
@pytest.mark.skipif(package_folder() is None, reason="LIBERO is not installed here: robogauntlet env create libero")
@pytest.mark.parametrize("task", PLAYED)
def test_the_oracle_succeeds_within_the_horizon(task: str) -> None:
    """Once as it acts, and once with noise of a tenth of the actions' range."""
    simulation = SIMULATOR.open(task, View(image_size=32, render_profile=RenderProfile.FAST))
    horizon = SIMULATOR.tasks[task].horizon
    steps = [
        steps_to_success(simulation, SCRIPTS[f"libero/{task}"](), seed, horizon, noise)
        for seed, noise in ((0, 0.0), (11, 0.1))
    ]
    simulation.close()
    assert None not in steps
