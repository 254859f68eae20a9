"""Packages provide oracles for their own simulators only, and the oracle's digest covers them."""

import inspect
import re
import sys
from importlib.metadata import EntryPoint

import pytest

from robogauntlet.policies import catalog, oracles
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.oracles.plugins import GROUP, load_oracles

MODULE = """
class Reach:
    def __call__(self, state):
        return {value}

GOOD = {{"mysim/Reach": Reach}}
FOREIGN = {{"robosuite/Lift": Reach}}
NO_SCRIPT = {{"mysim/Reach": 5}}
"""


@pytest.fixture
def declared(monkeypatch, tmp_path):
    """Declares entry points of a module whose script returns a value."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def declare(entries, value=1):
        (tmp_path / "plugin_module.py").write_text(MODULE.format(value=value))
        sys.modules.pop("plugin_module", None)
        points = [EntryPoint(name, f"plugin_module{suffix}", GROUP) for name, suffix in entries]
        found = oracles.plugins.metadata.entry_points
        monkeypatch.setattr(
            "robogauntlet.policies.oracles.plugins.metadata.entry_points",
            lambda group: points if group == GROUP else found(group=group),
        )
        forget()

    yield declare
    sys.modules.pop("plugin_module", None)
    monkeypatch.undo()
    forget()


def forget():
    load_oracles.cache_clear()
    oracles.scripts.cache_clear()


def test_a_script_of_another_package_plays_its_task(declared):
    declared([("mysim", ":GOOD")], value=7)
    assert oracles.scripts()["mysim/Reach"]()({}) == 7
    assert "robosuite/Lift" in oracles.scripts()
    assert "mysim/Reach" in catalog.find("oracle").tasks()


def test_the_oracles_digest_covers_scripts_of_other_packages(declared):
    alone = catalog.digest("oracle", {})
    declared([("mysim", ":GOOD")], value=1)
    first = catalog.digest("oracle", {})
    declared([("mysim", ":GOOD")], value=2)
    assert len({alone, first, catalog.digest("oracle", {})}) == 3


def test_a_tasks_digest_covers_the_script_of_its_own_simulator_only(declared):
    digests = []
    for value in (1, 2):
        declared([("mysim", ":GOOD")], value=value)
        tasks = ("mysim/Reach", "robosuite/Lift", "pybullet/PandaReach-v3")
        digests.append([oracles.digest_of_task(task) for task in tasks])
    first, second = digests
    assert [one == other for one, other in zip(first, second, strict=True)] == [False, True, True]
    assert len(set(second)) == 3


@pytest.mark.parametrize(
    ("task", "other"),
    [("gymnasium/FetchReach-v4", "pybullet"), ("maniskill/PushCube-v1", "maniskill_motion")],
    ids=["the-module-that-defines-its-script", "a-module-from-which-its-script-imports"],
)
def test_a_tasks_digest_covers(monkeypatch, task, other):
    before = oracles.digest_of_task(task)
    original = oracles.source_digest

    def without(*modules):
        return original(*(module for module in modules if not module.__name__.endswith(f".{other}")))

    monkeypatch.setattr(oracles, "source_digest", without)
    assert oracles.digest_of_task(task) != before


@pytest.mark.parametrize("source", oracles._sources(), ids=lambda source: source.name)
def test_a_digest_covers_all_that_its_scripts_import_from_beside_them(source):
    package = oracles.__name__
    covered = {module.__name__ for module in (oracles.motion, *source.modules())}
    imports = re.compile(rf"^from ({re.escape(package)}\.\w+) import", re.MULTILINE)
    imported = {name for module in source.modules() for name in imports.findall(inspect.getsource(module))}
    assert imported <= covered


def test_no_digest_covers_pythons_own_library():
    written = {module.__name__ for source in oracles._sources() for module in source.modules()}
    own = (*oracles._SCRIPT_MODULES, "maniskill_motion", "joints")
    assert written == {f"robogauntlet.policies.oracles.{name}" for name in own}


def test_a_task_without_a_script_has_no_digest():
    with pytest.raises(PolicyError, match="the oracle has no script for 'mysim/Nothing'"):
        oracles.digest_of_task("mysim/Nothing")


@pytest.mark.parametrize(
    ("entries", "reason"),
    [
        ([("mysim", ":GONE")], "plugin_module:GONE cannot be loaded: AttributeError"),
        (
            [("mysim", "")],
            "plugin_module is a module, expected a mapping of 'mysim/TASK' to callables that build a script",
        ),
        ([("mysim", ":FOREIGN")], "has a script for 'robosuite/Lift', expected tasks of its own simulator"),
        ([("mysim", ":NO_SCRIPT")], "has a int for 'mysim/Reach'"),
        ([("mysim", ":GOOD"), ("mysim", ":GOOD")], "is the second entry point named 'mysim'"),
        ([("robosuite", ":FOREIGN")], "'robosuite' has built-in oracles, which stay in use"),
    ],
)
def test_a_broken_entry_point_is_reported_and_affects_no_other(declared, entries, reason):
    own = oracles.scripts()["robosuite/Lift"]
    declared(entries)
    (broken,) = oracles.broken_plugins()
    assert reason in broken.reason
    assert oracles.scripts()["robosuite/Lift"] is own
