"""`robogauntlet report --cite`."""

import re

import pytest
import yaml

import robogauntlet
from robogauntlet.adapters import catalog
from tests import ROOT
from tests.results.synthetic import cells, document, run_folder


def keys(text):
    return re.findall(r"^@\w+\{([\w-]+),$", text, re.MULTILINE)


def test_without_a_run_the_tool_is_cited(run_command):
    done = run_command("report", "--cite")
    assert keys(done.out) == ["robogauntlet"]
    assert f"  version = {{{robogauntlet.__version__}}}\n" in done.out


def test_a_run_adds_its_hashes_and_the_simulators_that_played(run_command, tmp_path):
    plan = cells(tasks=("robosuite/Lift", "libero/x", "maniskill/PushCube-v1"))
    run = document(of=plan, rows_hash="abc123", name="night_1", skipped={"maniskill": "not installed"})
    text = run_command("report", "--cite", run_folder(tmp_path / "run", run, [])).out
    assert "  title = {{night\\_1}: an evaluation suite of {RoboGauntlet}}" in text
    assert "  note = {Suite hash 0123456789abcdef; run run-1, rows hash abc123}" in text
    simulators = ["zhu2020robosuite", "todorov2012mujoco", "liu2023libero", "zhou2025liberopro"]
    assert keys(text) == ["robogauntlet", "robogauntlet-suite-01234567", *simulators]


@pytest.mark.parametrize(("task", "key"), [("libero/x", "liu2023libero"), ("metaworld/reach-v3", "yu2019metaworld")])
def test_a_published_benchmark_is_cited_if_the_run_used_it(run_command, tmp_path, task, key):
    for played, is_cited in ((task, True), ("pybullet/PandaReach-v3", False)):
        run = run_folder(tmp_path / played, document(of=cells(tasks=(played,))), [])
        assert (key in keys(run_command("report", "--cite", run).out)) is is_cited


def test_every_brace_of_an_entry_is_closed_whatever_the_suite_is_called(run_command, tmp_path):
    text = run_command("report", "--cite", run_folder(tmp_path / "run", document(name="a}{{b"), [])).out
    for entry in text.split("\n\n"):
        assert entry.count("{") == entry.count("}")


def test_an_adapter_that_is_not_installed_is_named(run_command, tmp_path):
    run = document(of=cells(tasks=("mysim/Push",)))
    printed = run_command("report", "--cite", run_folder(tmp_path / "r", run, [])).out
    assert "% mysim: its adapter is not installed here" in printed


@pytest.mark.parametrize("name", [name for name, one in catalog.simulators().items() if not one.internal])
def test_every_simulator_declares_complete_entries(name):
    references = catalog.simulators()[name].references
    assert references
    for entry in references:
        assert re.match(r"@\w+\{\w+,\n", entry)
        assert entry.count("{") == entry.count("}")
        fields = set(re.findall(r"^  (\w+) = \{", entry, re.MULTILINE))
        assert {"title", "author", "year"} <= fields


def test_a_folder_without_a_run_is_refused(run_command, tmp_path):
    assert "expected a run folder" in run_command("report", "--cite", tmp_path).refusal


def test_the_citation_file_has_the_version_of_the_distribution():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == robogauntlet.__version__
