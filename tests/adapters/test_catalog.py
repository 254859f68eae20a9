"""Simulators and tasks by name."""

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator, UnknownTask
from robogauntlet.suites.episode import View


@pytest.mark.parametrize("name", [s.name for s in catalog.simulators().values() if not s.internal])
def test_an_unknown_task_is_refused_with_the_nearest_name(name):
    task = next(iter(catalog.find(name).tasks))
    with pytest.raises(UnknownTask, match=f"did you mean '{name}/{task}'"):
        catalog.open_simulation(f"{name}/{task}x", View())


@pytest.mark.parametrize(
    ("name", "distributions", "remedy"),
    [
        ("pybullet", ("pybullet",), 'install it: pip install "robogauntlet[pybullet]"'),
        ("desk", ("desk-sim", "mujoco"), "install it: pip install desk-sim mujoco"),
        ("desk", (), "install the package that provides it"),
    ],
)
def test_a_missing_simulator_is_reported_with_a_way_to_install_it(name, distributions, remedy):
    simulator = Simulator(name, "", {}, ("no_such_module",), distributions, open)
    assert catalog.missing_reason(simulator) == f"not installed (no module no_such_module); {remedy}"
