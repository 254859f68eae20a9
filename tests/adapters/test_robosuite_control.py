"""A control step of the adapter is robosuite's own, to the bit."""

import numpy as np
import pytest

from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.adapters.robosuite.simulation import control_loop
from robogauntlet.suites.episode import RenderProfile, View
from tests.adapters.control_steps import alternating, check_compiled, ours, played, robosuites
from tests.jobs import mostly_nightly

pytestmark = pytest.mark.simulator


@pytest.fixture(scope="module", params=mostly_nightly(["Lift", "Stack", "Door", "PickPlaceCan"], ["Lift", "Door"]))
def simulation(request):
    opened = SIMULATOR.open(request.param, View(image_size=48, render_profile=RenderProfile.FAST))
    yield opened
    opened.close()


@pytest.mark.parametrize("perturbed", [False, True], ids=["clean", "perturbed"])
@pytest.mark.parametrize("seed", mostly_nightly([0, 1, 2], [0]))
def test_a_step_is_robosuites_own_to_the_bit(simulation, seed, perturbed):
    own = played(simulation, seed, robosuites, perturbed=perturbed)
    assert np.array_equal(own, played(simulation, seed, ours, perturbed=perturbed))


def test_robosuites_own_steps_may_be_taken_in_between(simulation):
    own = played(simulation, 3, robosuites)
    assert np.array_equal(own, played(simulation, 3, alternating()))


def test_a_law_that_cannot_be_compiled_is_left_to_robosuite(simulation, monkeypatch, caplog):
    simulation.reset(0)
    controller = simulation._env.robots[0].part_controllers["right"]
    monkeypatch.setattr(controller, "qvel_index", controller.qvel_index[::-1])
    loop = control_loop(simulation._physics, simulation._env)
    assert not loop.exact
    assert "cannot be compiled (ValueError: expected consecutive numbers" in caplog.text


def test_a_law_that_is_not_the_compiled_one_is_left_to_robosuite(simulation, monkeypatch):
    check_compiled(simulation)
    simulation.reset(0)
    monkeypatch.setattr(simulation._env.robots[0].part_controllers["right"], "uncoupling", False)
    monkeypatch.setattr(simulation, "_control", control_loop(simulation._physics, simulation._env))
    assert not simulation._control.exact
    assert np.array_equal(played(simulation, 0, robosuites), played(simulation, 0, ours))
