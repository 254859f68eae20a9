"""Suites are checked and planned where neither simulators nor torch are installed."""

import inspect
import socket
import sys

import pytest

from robogauntlet.orchestrator.cli.check.installation import LISTENS
from robogauntlet.orchestrator.cli.serve.dashboard import serve as dashboard
from robogauntlet.orchestrator.cli.serve.policy import serve as policy_server
from robogauntlet.orchestrator.registry import SHIPPED
from robogauntlet.orchestrator.runs.plan import make_plan
from tests.processes import run_process

MISSING = (
    *("torch", "mujoco", "robosuite", "sapien", "mani_skill", "pybullet", "panda_gym", "metaworld", "gymnasium"),
    *("libero", "lerobot", "sklearn", "transformers"),
)
WITHOUT = f"""
import sys
from importlib.machinery import PathFinder
find_spec = PathFinder.find_spec
PathFinder.find_spec = lambda name, *rest: None if name.partition(".")[0] in {MISSING} else find_spec(name, *rest)
from robogauntlet.orchestrator.cli import main
main()
"""
SUITE = "name: s\npolicies: [oracle]\ntasks: [pybullet/PandaReach-v3]\nseeds: {count: 2}\n"


def run_without_simulators(*arguments):
    return run_process([sys.executable, "-c", WITHOUT, *arguments], SHIPPED)


@pytest.fixture
def suite(tmp_path):
    file = tmp_path / "suite.yaml"
    file.write_text(SUITE)
    return file


def test_every_shipped_suite_is_valid_without_simulators_and_torch():
    names = sorted(path.stem for path in SHIPPED.glob("*.yaml"))
    done = run_without_simulators("plan", "--check", *names)
    assert (done.returncode, done.stderr) == (0, "")
    valid = [line for line in done.stdout.splitlines() if ": valid, " in line]
    assert len(valid) == len(names)
    assert "note: simulator maniskill: not installed" in done.stdout
    assert "note: not checked whether the policies experts, merged-oracle-routed" in done.stdout


def test_the_hash_does_not_depend_on_what_is_installed():
    done = run_without_simulators("plan", "--check", "mergevla", "zoo")
    for name in ("mergevla", "zoo"):
        plan = make_plan(SHIPPED / f"{name}.yaml", require_installed=False)
        assert f"hash {plan.suite_hash}\n" in done.stdout


def test_mistakes_are_reported_without_simulators(suite):
    suite.write_text(SUITE.replace("PandaReach", "PandaReech").replace("oracle", "oracel"))
    done = run_without_simulators("plan", "--check", suite)
    assert done.returncode == 2
    assert done.stderr.count("did you mean") == 2


@pytest.mark.parametrize("verb", [("plan", "--check"), ("plan",)])
def test_nothing_that_a_suite_names_is_imported_contacted_or_started(run_command, monkeypatch, tmp_path, verb):
    marker = tmp_path / "started"
    (tmp_path / "named.py").write_text(f"open({str(marker)!r}, 'w')\n\n\ndef act(**observation):\n    pass\n")
    interpreter = tmp_path / "python"
    interpreter.write_text(f"#!/bin/sh\ntouch {marker}\n")
    interpreter.chmod(0o755)
    configuration = tmp_path / "config.yaml"
    configuration.write_text(f"environments: {{pybullet: {{interpreter: {interpreter}}}}}\n")
    policy = f"{{name: mine, kind: python, options: {{callable: 'named:act', folder: '{tmp_path}'}}}}"
    file = tmp_path / "suite.yaml"
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"openpi://127.0.0.1:{server.getsockname()[1]}"
        file.write_text(SUITE.replace("[oracle]", f'[oracle, {policy}, "{address}"]'))
        monkeypatch.setenv("ROBOGAUNTLET_CONFIG", str(configuration))
        done = run_command(*verb, file)
        server.settimeout(0.1)
        with pytest.raises(TimeoutError):
            server.accept()
    assert (done.code, done.err) == (0, "")
    assert "6 episodes" in done.out
    assert "nothing that a suite names is imported or contacted; --start does" in done.out
    assert not marker.exists()


@pytest.mark.parametrize("policy", ["lerobot:x/y", "{name: m, kind: mergevla, options: {checkpoint: x/y}}"])
def test_nothing_is_downloaded_from_the_hub(tmp_path, run_command, monkeypatch, policy):
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda *_, **__: pytest.fail("downloads"))
    (tmp_path / "suite.yaml").write_text(SUITE.replace("[oracle]", f"[{policy}]"))
    done = run_command("plan", "--check", "suite.yaml")
    assert (done.code, done.err) == (0, "")
    assert "2 episodes, hash unknown until its policies can be identified" in done.out


@pytest.mark.parametrize("verb", [("plan", "--check"), ("plan",)])
def test_a_policy_server_that_does_not_answer_is_a_note(run_command, tmp_path, verb):
    file = tmp_path / "suite.yaml"
    file.write_text(SUITE.replace("[oracle]", '[oracle, "openpi://127.0.0.1:9"]'))
    done = run_command(*verb, "--start", file)
    assert done.code == 0
    assert "4 episodes" in done.out
    assert "hash unknown until its policies can be identified" in done.out
    assert "policy server ws://127.0.0.1:9" in done.out + done.err


def test_the_doctor_fails_where_no_simulator_is_installed():
    done = run_without_simulators("check", "installation")
    assert done.returncode == 1
    assert "note: maniskill: not installed" in done.stdout
    assert "robogauntlet: no simulator is installed; install one: pip install" in done.stderr
    listens = "listens: robogauntlet serve dashboard: 127.0.0.1, port 8770; elsewhere by --host, with a token"
    assert listens in done.stdout


@pytest.mark.parametrize(("verb", "serve"), [("serve dashboard", dashboard), ("serve policy", policy_server)])
def test_the_doctor_lists_the_ports_of_the_commands(verb, serve):
    assert f"port {inspect.signature(serve).parameters['port'].default};" in LISTENS[f"robogauntlet {verb}"]


def test_a_plan_lists_episodes_and_names_the_missing_simulators(suite):
    done = run_without_simulators("plan", suite)
    assert done.returncode == 0
    assert "s: 2 episodes, 0 to play" in done.stdout
    assert "robogauntlet: pybullet is skipped: not installed (no module" in done.stderr


def test_a_run_still_needs_a_simulator(suite, tmp_path):
    done = run_without_simulators("run", suite, "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "pybullet: not installed (no module" in done.stderr
    assert not (tmp_path / "run").exists()
