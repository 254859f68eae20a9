"""A control step of the adapter is LIBERO's own, to the bit; tested where LIBERO is installed."""

import numpy as np
import pytest

from robogauntlet.adapters.libero import SIMULATOR
from robogauntlet.suites.episode import RenderProfile, View
from tests.adapters.control_steps import alternating, check_compiled, ours, played, robosuites

pytestmark = [pytest.mark.simulator, pytest.mark.apart("libero")]


@pytest.fixture(scope="module", params=["spatial-4-in-top-drawer-wooden-cabinet", "goal-8-put-bowl-on-plate"])
def simulation(request):
    opened = SIMULATOR.open(request.param, View(image_size=48, render_profile=RenderProfile.FAST))
    yield opened
    opened.close()


@pytest.mark.parametrize("perturbed", [False, True], ids=["clean", "perturbed"])
def test_a_step_is_liberos_own_to_the_bit(simulation, perturbed):
    check_compiled(simulation)
    own = played(simulation, 1, robosuites, perturbed=perturbed)
    assert np.array_equal(own, played(simulation, 1, ours, perturbed=perturbed))


def test_liberos_own_steps_may_be_taken_in_between(simulation):
    own = played(simulation, 2, robosuites)
    assert np.array_equal(own, played(simulation, 2, alternating()))
