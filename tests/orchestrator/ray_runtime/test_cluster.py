"""The head of a joined cluster, and the nodes that can open a simulator."""

import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.ray_runtime import cluster
from robogauntlet.orchestrator.ray_runtime.cluster import ClusterHead, NoCluster, Placement, check_address, placed_on
from tests.remote_servers import answering, speaking


class Clock:
    """A clock that only sleeping moves."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def listening():
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def closed_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


def test_a_head_that_is_silent_too_long_counts_as_dead():
    clock = Clock()
    head = ClusterHead(f"127.0.0.1:{closed_port()}", clock, clock.sleep)
    assert "has not answered for 20 s" in head.wait_for_answer()
    assert cluster.SILENCE_S <= clock.now <= cluster.SILENCE_S + cluster.PROBE_S


def test_a_head_that_answers_again_is_alive(monkeypatch):
    clock, answers = Clock(), iter(["refused", "refused", None])
    monkeypatch.setattr(cluster, "_connect", lambda *_: next(answers))
    assert ClusterHead("node:6379", clock, clock.sleep).wait_for_answer() is None
    assert next(answers, "all asked") == "all asked"


def test_a_head_that_has_just_answered_is_not_asked_again(listening, monkeypatch):
    clock = Clock()
    head = ClusterHead(f"127.0.0.1:{listening.getsockname()[1]}", clock, clock.sleep)
    assert head.wait_for_answer() is None
    monkeypatch.setattr(cluster, "_connect", lambda *_: pytest.fail("asked again"))
    assert head.wait_for_answer(after_s=2.0) is None


@pytest.mark.parametrize(
    "address", ["", "node", "node:", ":6379", "node:0", "node:65536", "node:٣", "http://node:1", "a/b:1"]
)
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(NoCluster, match="expected HOST:PORT"):
        check_address(address)


def test_what_answers_at_an_address_and_is_no_head_is_refused(monkeypatch):
    monkeypatch.setattr(cluster, "ASK_S", 0.5)
    with speaking(answering({})) as address, pytest.raises(NoCluster, match="something else answers there"):
        check_address(address.removeprefix("ws://"))


@pytest.mark.parametrize(
    ("address", "says"), [("auto", "that runs on this machine, found none"), ("{}", "something else answers there")]
)
def test_a_command_without_its_cluster_is_one_line_and_leaves_no_folder(
    tmp_path, run_command, monkeypatch, listening, address, says
):
    monkeypatch.setattr(cluster, "_ask", lambda address: cluster.NO_HEAD)
    (tmp_path / "suite.yaml").write_text("name: s\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 1}\n")
    address = address.format(f"127.0.0.1:{listening.getsockname()[1]}")
    for out in ((), ("--out", "run")):
        refusal = run_command("run", "suite.yaml", *out, "--address", address).refusal
        assert refusal.startswith(f"--address {address}: expected ")
        assert says in refusal
    assert [path.name for path in tmp_path.iterdir()] == ["suite.yaml"]


@pytest.fixture
def short():
    """A folder with a path that is short enough for Ray's sockets."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        yield folder


@pytest.mark.ray
def test_a_cluster_with_another_token_is_refused_before_anything_starts(tmp_path, run_command, monkeypatch, short):
    (tmp_path / "suite.yaml").write_text("name: s\npolicies: [oracle]\ntasks: [null/Reach]\nseeds: {count: 1}\n")
    address = f"127.0.0.1:{closed_port()}"
    ray = str(Path(sys.executable).with_name("ray"))
    options = ["--head", f"--port={address[10:]}", "--node-ip-address=127.0.0.1", "--include-dashboard=false"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    environment |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "a" * 64, "RAY_USAGE_STATS_ENABLED": "0"}
    head = [ray, "start", *options, "--num-cpus=1", f"--temp-dir={short}", "--block"]
    process = subprocess.Popen(head, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_for_head(address, process)
        monkeypatch.setenv("RAY_AUTH_MODE", "token")
        monkeypatch.setenv("RAY_AUTH_TOKEN", "b" * 64)
        refusal = run_command("run", "suite.yaml", "--out", "run", "--address", address).refusal
        assert refusal.startswith(f"--address {address}: expected the token of this Ray cluster")
        assert not (tmp_path / "run").exists()
        monkeypatch.setenv("RAY_AUTH_TOKEN", "a" * 64)
        check_address(address)
    finally:
        process.terminate()
        process.wait(60)


def wait_for_head(address, process):
    deadline = time.monotonic() + 60
    while True:
        try:
            return check_address(address)
        except NoCluster as error:
            if "token" in str(error):
                return None
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.2)


def nodes_without(simulator, lacking, monkeypatch):
    """A cluster of these nodes, some of which lack the simulator."""
    monkeypatch.setattr(
        "ray.nodes", lambda: [{"NodeID": name, "Alive": name != "dead"} for name in ("a", "b", "c", "dead")]
    )
    asked = []

    def ask(self, nodes, simulator):
        asked.extend(nodes)
        self._reasons |= {(node, simulator.name): "not installed" if node in lacking else None for node in nodes}

    monkeypatch.setattr(Placement, "_ask", ask)
    return asked


@pytest.mark.parametrize(
    ("lacking", "nodes", "options"),
    [
        ("", "", {}),
        ("b", "ac", {"label_selector": {"ray.io/node-id": "in(a,c)"}}),
        ("ab", "c", {"label_selector": {"ray.io/node-id": "in(c)"}}),
        ("abc", "", {}),
    ],
)
def test_workers_are_placed_where_their_simulator_can_be_opened(lacking, nodes, options, monkeypatch):
    simulator = catalog.find("null")
    asked = nodes_without(simulator, lacking, monkeypatch)
    placement = Placement(EnvironmentResolver())
    assert placement.nodes(simulator) == placement.nodes(simulator) == frozenset(nodes)
    assert placed_on(placement.nodes(simulator)) == options
    assert placement.able(simulator) == [node for node in "abc" if node not in lacking]
    assert asked == ["a", "b", "c"]


@pytest.mark.parametrize(("lacking", "nodes"), [("bc", "a"), ("", "")])
def test_a_worker_waits_for_no_lost_node_that_lacked_its_simulator(lacking, nodes, monkeypatch):
    """Such a node comes back under another id, and would be taken for one that can open it."""
    simulator = catalog.find("null")
    nodes_without(simulator, lacking, monkeypatch)
    placement = Placement(EnvironmentResolver())
    placement.nodes(simulator)
    monkeypatch.setattr("ray.nodes", lambda: [{"NodeID": name, "Alive": name == "a"} for name in "abc"])
    assert placement.nodes(simulator) == frozenset(nodes)
