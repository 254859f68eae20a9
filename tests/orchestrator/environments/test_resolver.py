"""The environment of each simulator, and runs with several environments."""

import json
import re
import subprocess
import sys
from importlib import metadata

import pytest
from packaging.requirements import Requirement

import robogauntlet
from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.cli.common import EXIT_BAD_INPUT
from robogauntlet.orchestrator.environments.environment import WORKER_PACKAGES
from robogauntlet.orchestrator.environments.probe import probe
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.suites.environments import Config, EnvironmentEntry
from tests import ROOT

PLAY = """
import sys
sys.modules.update(dict.fromkeys(sys.argv[1:]))
from robogauntlet.orchestrator.demonstrations import recorder
from robogauntlet.orchestrator.environments import probe
from robogauntlet.orchestrator.episodes import video_recorder
from robogauntlet.orchestrator.ray_runtime import simulator_processes
from robogauntlet.orchestrator.replay import media, verify
from robogauntlet.orchestrator.scheduling import ray_worker
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.suites.episode import Episode, Protocol, View
runner = EpisodeRunner({"random": PolicySource("random")})
print(runner.play_one(Episode("random", "digest", "null/Reach", 1, Protocol(3, 1, View(("wrist",), 16)))).status)
"""
SUITE = """
name: two-environments
policies: [random]
tasks: [first/Reach, second/Reach, bare/Reach]
seeds: {count: 1}
horizon: 6
image_size: 16
"""


def test_a_suite_overrides_the_configuration_which_overrides_the_adapter(simulators):
    first = catalog.find("first")
    of_suite, of_user = EnvironmentEntry(requirements=("a",)), EnvironmentEntry(requirements=("b",))
    config = Config(environments={"first": of_user})
    assert EnvironmentResolver({"first": of_suite}, config).resolve(first).entry is of_suite
    assert EnvironmentResolver({}, config).resolve(first).entry is of_user
    assert EnvironmentResolver({}, Config()).resolve(first).entry.requirements == ("gearbox==1.0",)


def test_an_adapters_environment_is_used_only_if_the_running_one_lacks_the_simulator(simulators, monkeypatch):
    (simulators / "elsewhere").mkdir(exist_ok=True)
    (simulators / "elsewhere" / "gearbox.py").touch()
    monkeypatch.syspath_prepend(simulators / "elsewhere")
    assert EnvironmentResolver({}, Config()).resolve(catalog.find("first")) is None


def test_the_doctor_checks_the_environments(made):
    first, second = probe(["first", "second"])
    assert (first.render_device, first.versions) == ("gearbox 1.0", {"gearbox": "1.0"})
    assert (second.render_device, second.versions) == ("gearbox 2.0", {"gearbox": "2.0"})


@pytest.mark.ray
def test_a_run_uses_two_environments_records_them_and_can_be_replayed(
    made, ray_here, run_command, tmp_path, monkeypatch
):
    (tmp_path / "suite.yaml").write_text(SUITE)
    done = run_command("run", "suite.yaml", "--out", "run", "--no-media")
    assert done.code == 0, done.err
    assert "bare is skipped: not installed (no module gearbox)" in done.err
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    assert document["render_devices"] == {"first": "gearbox 1.0", "second": "gearbox 2.0"}
    environments = document["provenance"]["environments"]
    assert environments["second"]["packages"] == {"gearbox": "2.0"}
    assert environments["second"]["hash"] == EnvironmentEntry(requirements=("gearbox==2.0",)).hash
    assert "first: gearbox | 1.0" in (tmp_path / "run" / "report.md").read_text()
    assert "2 of 2 episodes replayed: all the same" in run_command("replay", "--verify", "run").out
    episode = robogauntlet.open_run(tmp_path / "run").episodes().set_index("simulator").loc["second", "episode_id"]
    assert "the same as stored" in run_command("replay", episode, "--run", "run").out
    python = EnvironmentResolver().resolve(catalog.find("second")).python
    (tmp_path / "config.yaml").write_text(f"environments: {{first: {{interpreter: {python}}}}}\n")
    monkeypatch.setenv("ROBOGAUNTLET_CONFIG", str(tmp_path / "config.yaml"))
    moved = run_command("run", "suite.yaml", "--out", "run")
    assert moved.code == EXIT_BAD_INPUT
    assert re.search("first ran in environment .*, and would now run in environment .*; give another", moved.err)


def requires(name):
    return {Requirement(text).name.lower() for text in metadata.requires(name) or () if "extra" not in text}


def test_an_environment_that_inherits_nothing_has_all_that_workers_import():
    there, found = {"robogauntlet"}, {"ray", *WORKER_PACKAGES}
    while found - there:
        there |= found
        found = {needed for name in there - {"robogauntlet"} for needed in requires(name)}
    absent = requires("robogauntlet") - there
    assert {"sqlalchemy", "typer"} <= absent
    names = metadata.packages_distributions()
    modules = sorted(name for name, of in names.items() if {one.lower() for one in of} & absent)
    done = subprocess.run([sys.executable, "-c", PLAY, *modules], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.stdout == "failure\n", done.stderr
    assert all(name in map(str.lower, names[module]) for name, module in WORKER_PACKAGES.items())
