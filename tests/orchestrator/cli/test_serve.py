"""`robogauntlet serve policy`, and runs of suites with its policies."""

import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, Query
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.orchestrator.runs.playing import rows_of
from tests.processes import GAUNTLET
from tests.remote_servers import answering, serving, speaking


@contextmanager
def served(policy, *options):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(
        [*GAUNTLET, "serve", "policy", policy, "--port", "0", *options], env=environment, **pipes
    )
    try:
        line = process.stdout.readline()
        found = re.search(r"ws://\S+?:\d+", line)
        assert found, process.stderr.read()
        yield SimpleNamespace(process=process, address=found[0], first_line=line)
    finally:
        process.kill()
        process.communicate()


def run_of(run_command, folder, policies, tasks="[null/Reach]", count=6):
    suite = f"name: s\npolicies: {yaml.safe_dump(policies, default_flow_style=True)}tasks: {tasks}\n"
    (folder / "s.yaml").write_text(
        f"{suite}seeds: {{count: {count}}}\nworkers: 1\nimage_size: 32\nerror_tolerance: 1.0\n"
    )
    return run_command("run", "s.yaml", "--out", "run", "--no-media")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_a_signal_stops_it(number):
    with served("untrained") as server:
        digest = catalog.digest("untrained", {})
        assert f"serving untrained ({digest}) at ws://127.0.0.1:" in server.first_line
        assert catalog.digest("openpi", {"address": server.address}) == digest
        server.process.send_signal(number)
        out, err = server.process.communicate(timeout=20)
        assert (server.process.returncode, out, err) == (0, "stopped\n", "")


@pytest.mark.parametrize("size", [32, 1024])  # more than the kernel keeps for a server that does not read
def test_a_hanging_server_is_one_line_and_is_asked_again_later(size):
    images = {camera: np.zeros((size, size, 3), np.uint8) for camera in ("third_person", "wrist")}
    episode = Episode("p", "d", "null/Reach", 0, Protocol(60, 8, View(image_size=size)))
    query = Query(episode, 0, Observation(images, np.zeros(8), "reach"))
    with served("untrained") as server:
        policy = catalog.load("openpi", {"address": server.address, "timeout_s": 1.0, "retries": 0})
        server.process.send_signal(signal.SIGSTOP)
        with pytest.raises(PolicyError, match=r"expected an answer within [^\n]* got none"):
            policy.act([query])
        server.process.send_signal(signal.SIGCONT)
        policy = catalog.load("openpi", {"address": server.address})
        assert len(policy.act([query])) == 1


def test_an_invalid_policy_or_address_is_one_line(run_command, tmp_path, monkeypatch):
    monkeypatch.delenv("ROBOGAUNTLET_TOKEN", raising=False)
    taken = socket.create_server(("127.0.0.1", 0))
    port = taken.getsockname()[1]
    for arguments, match in (
        (("untraned",), "the folder of a checkpoint or a kind of policy; got 'untraned'; did you mean 'untrained'?"),
        (("zoo:mergd",), "expected the name of a shipped checkpoint after 'zoo:'"),
        (("zero", "--host", "0.0.0.0"), "--host 0.0.0.0: expected a token in ROBOGAUNTLET_TOKEN"),
        (("zero", "--port", port), f"cannot listen on 127.0.0.1:{port}: "),
        (
            ("oracle", "--protocol", "vla-eval"),
            "protocol vla-eval: expected a policy that sees observations, got one that",
        ),
        (("mergevla", "--option", "checkpont=x"), "policy 'mergevla' has no option 'checkpont'; did you mean"),
        (("python:no_such_thing:x",), "expected a module 'no_such_thing'"),
        (("openpi://127.0.0.1:1", "--option", "retries=0"), "no connection"),
    ):
        assert match in run_command("serve", "policy", *arguments).refusal
    taken.close()


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_a_run_with_a_policy_server_has_the_same_results(run_command, tmp_path):
    found = []
    with serving("untrained") as server:
        remote = {"name": "untrained", "kind": "openpi", "options": {"address": server.address}}
        for policies in (["untrained"], [remote]):
            folder = tmp_path / str(len(found))
            folder.mkdir()
            os.chdir(folder)
            assert run_of(run_command, folder, policies).code == 0
            found.append(rows_hash(map(outcome_row, rows_of(folder / "run"))))
    assert found[0] == found[1]


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_a_failing_server_causes_error_rows_of_its_policy_only(run_command, tmp_path):
    (tmp_path / "brains.py").write_text(
        "import numpy as np\ndef act(images, proprioception, instruction):\n    return np.zeros((4, 7))\n"
    )
    mine = {"name": "mine", "kind": "python", "options": {"callable": "brains:act", "folder": str(tmp_path)}}
    with speaking(answering({"actions": [[float("nan")] * 7]})) as address:
        remote = {"name": "pi0", "kind": "openpi", "options": {"address": address, "identity": "pi0@1"}}
        run_of(run_command, tmp_path, [remote, "zero", mine], count=4)
    found = rows_of(tmp_path / "run")
    statuses = {name: {row.status for row in found if row.policy == name} for name in {row.policy for row in found}}
    assert statuses["zero"] == statuses["mine"] == {"failure"}
    assert statuses["pi0"] == {"error"}
    errors = {row.error for row in found if row.policy == "pi0"}
    assert errors == {
        f"PolicyMismatch: policy server {address}: expected finite numbers as 'actions', got nan in row 0, column 0"
    }


def test_a_dead_server_or_a_broken_module_starts_nothing(run_command, tmp_path):
    (tmp_path / "gpuless.py").write_text("raise RuntimeError('no GPU')\n")
    dead = {"name": "pi0", "kind": "openpi", "options": {"address": "127.0.0.1:1", "retries": 0}}
    result = run_of(run_command, tmp_path, [dead, "python:gpuless:act", "zero"])
    assert result.code == 2
    assert not (tmp_path / "run").exists()
    first, second = [line for line in result.err.splitlines() if "policy" in line]
    assert "policy 'pi0': policy server ws://127.0.0.1:1: expected an answer" in first
    assert "importing 'gpuless' raised RuntimeError: no GPU" in second
