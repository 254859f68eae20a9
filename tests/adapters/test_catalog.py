"""Simulators and tasks by name."""

from dataclasses import replace

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator, TaskDescription, UnknownTask
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


def test_a_simulator_without_wheels_for_this_python_says_for_which_there_are(monkeypatch):
    simulator = replace(catalog.find("pybullet"), modules=("no_such_module",))
    monkeypatch.setattr("sys.version_info", (3, 12, 1))
    found = catalog.missing_reason(simulator)
    assert found.endswith("with Python 3.11, the newest for which its packages have wheels")
    monkeypatch.setattr("sys.version_info", (3, 11, 9))
    assert catalog.missing_reason(simulator).endswith('pip install "robogauntlet[pybullet]"')


def test_a_simulator_without_the_modules_of_any_task_is_not_installed():
    lacking = TaskDescription("reach", 1, modules=("no_such_module",))
    simulator = replace(catalog.find("null"), tasks={"First": lacking})
    assert catalog.missing_reason(simulator).startswith("not installed (no module no_such_module)")
    both = replace(simulator, tasks={"First": lacking, "Second": TaskDescription("reach", 1)})
    assert catalog.missing_reason(both) is None
    assert catalog.installed_task(both) == "Second"


@pytest.mark.parametrize(
    ("task", "own"),
    [
        ("libero-plus/robot-goal-7-448", "libero/goal-7-turn-on-stove"),
        ("libero/goal-7-turn-on-stove", "libero/goal-7-turn-on-stove"),
        ("null/Reach", "null/Reach"),
        ("null/Unknown", "null/Unknown"),
        ("nowhere/Reach", "nowhere/Reach"),
    ],
)
def test_the_original_of_a_variant_is_the_task_that_it_varies(task, own):
    assert catalog.original(task) == own
