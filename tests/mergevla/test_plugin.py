"""MergeVLA as a distribution of its own: its verb, its kinds in other environments, and what is said without it."""

import os
import sys
from importlib.metadata import version

import pytest

from robogauntlet.orchestrator.cli import plugin_verbs
from robogauntlet.orchestrator.environments.source_path import import_path
from robogauntlet.orchestrator.registry import find_suite, load_registry
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.references import read_reference
from robogauntlet.suites.loading import SuiteError, load_suite
from robogauntlet.support.errors import BadInput
from tests.errors import one_line_error
from tests.processes import run_process

KINDS = ("mergevla", "mergevla-experts", "mergevla-merged")


@pytest.fixture
def core_alone(monkeypatch):
    """The kinds of an installation without MergeVLA."""
    others = {name: kind for name, kind in catalog.kinds().items() if name not in KINDS}
    monkeypatch.setattr(catalog, "kinds", lambda: others)


def test_its_verb_stands_in_the_help_with_the_summary_of_its_distribution():
    address, line = plugin_verbs.plugin_verbs()["mergevla"]
    assert address == "robogauntlet_mergevla.cli:app"
    assert line.startswith("Train MergeVLA's experts")


def test_metadata_that_are_no_text_hide_no_verb(tmp_path, monkeypatch):
    for name, points in (("odd", b"\xff"), ("own", b"[robogauntlet.verbs]\ndance = own:dance\n\n[other]\nx = y:z\n")):
        (tmp_path / f"{name}-1.dist-info").mkdir()
        (tmp_path / f"{name}-1.dist-info" / "entry_points.txt").write_bytes(points)
        (tmp_path / f"{name}-1.dist-info" / "METADATA").write_text("Name: own\nSummary: Dances.\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), str(tmp_path / "absent")])
    assert plugin_verbs.plugin_verbs.__wrapped__() == {"dance": ("own:dance", "Dances.")}


def test_an_environment_that_inherits_nothing_finds_its_kinds():
    code = (
        "from importlib.metadata import entry_points, version\n"
        "print(version('robogauntlet'), *sorted(entry.name for entry in entry_points(group='robogauntlet.policies')))"
    )
    done = run_process([sys.executable, "-S", "-c", code], PYTHONPATH=import_path().partition(os.pathsep)[0])
    number, *names = done.stdout.split()
    assert number == version("robogauntlet")
    assert set(names) == set(catalog.kinds())


@pytest.mark.usefixtures("core_alone")
def test_a_suite_that_needs_it_is_refused_with_what_installs_it():
    with pytest.raises(SuiteError, match=r"policy 'mergevla-merged' is not installed; .* pip install \./mergevla"):
        load_suite(find_suite("mergevla"), load_registry())
    with one_line_error(PolicyError, r"policy 'mergevla' is not installed; .* pip install \./mergevla"):
        catalog.find("mergevla")


@pytest.mark.usefixtures("core_alone")
@pytest.mark.parametrize("text", ["zoo:merged", "mergevla-merged"])
def test_a_reference_that_needs_it_is_refused_with_what_installs_it(text):
    with one_line_error(BadInput, rf"got '{text}', which is not installed; .* pip install \./mergevla"):
        read_reference(text)
