"""Entry points and misspelt names."""

from dataclasses import dataclass
from importlib.metadata import EntryPoint

import pytest

from robogauntlet.suites.plugins import Plugins, did_you_mean


@dataclass(frozen=True)
class Thing:
    name: str


GOOD, MISNAMED, NO_THING = Thing("good"), Thing("other"), 5


@pytest.fixture
def declared(monkeypatch):
    def declare(**entries):
        points = [EntryPoint(name, f"{__name__}:{value}", "things") for name, value in entries.items()]
        monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points)
        return Plugins("things", Thing)

    return declare


def test_a_broken_plugin_affects_no_other(declared):
    things = declared(good="GOOD", missing="NOT_THERE", wrong="NO_THING", renamed="MISNAMED")
    assert dict(things) == {"good": GOOD}
    reasons = {plugin.name: plugin.reason for plugin in things.broken}
    assert set(reasons) == {"missing", "wrong", "renamed"}
    assert "cannot be loaded: AttributeError" in reasons["missing"]
    assert reasons["wrong"].endswith("NO_THING is a int, expected a Thing")
    assert reasons["renamed"].endswith("is named 'other', its entry point 'renamed'")


def test_a_plugin_that_is_looked_up_is_loaded_alone(monkeypatch):
    loaded = []
    monkeypatch.setattr(EntryPoint, "load", lambda entry: loaded.append(entry.name) or Thing(entry.name))
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [EntryPoint(n, "m:v", group) for n in "cab"])
    things = Plugins("things", Thing)
    assert ("b" in things, "d" in things, things["b"]) == (True, False, Thing("b"))
    assert loaded == ["b"]
    assert (list(things), things.broken) == (["a", "b", "c"], ())
    assert sorted(loaded) == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("name", "known", "expected"),
    [
        ("Lfit", ["Lift", "Door"], "; did you mean 'Lift'?"),
        ("Lift", ["robosuite/Lift", "maniskill/PushCube-v1"], "; did you mean 'robosuite/Lift'?"),
        ("xyz", ["Lift", "Door"], "; known: Door, Lift"),
        ("xyz", [], "; there are none"),
        ("q", list("abcdefghijklmn"), "; known: a, b, c, d, e, f, g, h, i, j, k, l and 2 more"),
    ],
)
def test_an_unknown_name_is_answered_with_the_nearest_or_all_names(name, known, expected):
    assert did_you_mean(name, known) == expected
