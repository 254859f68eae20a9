"""Simulators and tasks by name."""

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import UnknownTask
from robogauntlet.suites.episode import View


@pytest.mark.parametrize("name", [s.name for s in catalog.simulators().values() if not s.internal])
def test_an_unknown_task_is_refused_with_the_nearest_name(name):
    task = next(iter(catalog.find(name).tasks))
    with pytest.raises(UnknownTask, match=f"did you mean '{name}/{task}'"):
        catalog.open_simulation(f"{name}/{task}x", View())
