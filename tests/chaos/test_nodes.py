"""A run on a Ray cluster that a node joins, and then dies."""

import os
import subprocess
import sys
import time

import psutil
import pytest
from ray.cluster_utils import Cluster

from robogauntlet.results.run_document import RUN_FILE, RunStatus, read_run

pytestmark = [pytest.mark.ray, pytest.mark.chaos]


POLICY = """
import time
from pathlib import Path

import numpy as np


def policy(images, proprioception, instruction):
    until = time.monotonic() + 9
    while time.monotonic() < until and not Path("GATE").exists():
        time.sleep(0.1)
    return np.zeros((60, 7))
"""
SUITE = """
name: nodes
policies: [oracle, {name: waits, kind: python, options: {callable: "mine:policy", folder: FOLDER}}]
tasks: [null/Slow]
seeds: {count: 20}
workers: auto
episode_time_limit_s: 600
"""
"""Each query waits 9 s, or for a file, so that the run is not over before a node has joined."""


@pytest.fixture
def cluster():
    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    yield nodes
    nodes.shutdown()


def command(suite, folder, *more):
    program = "import sys; from robogauntlet.orchestrator.cli import main; main()"
    return [sys.executable, "-c", program, "run", str(suite), "--out", str(folder), "--no-media", *more]


def workers_on(node):
    """Processes of workers that play on a node of this machine."""
    (raylet,) = node.all_processes["raylet"]
    return [
        process
        for process in psutil.process_iter(["ppid", "cmdline"])
        if process.info["ppid"] == raylet.process.pid and "ray::Worker.play" in " ".join(process.info["cmdline"] or ())
    ]


def test_a_node_that_joins_gets_workers_and_its_death_changes_no_row(cluster, tmp_path):
    suite, gate = tmp_path / "suite.yaml", tmp_path / "gate"
    suite.write_text(SUITE.replace("FOLDER", str(tmp_path)))
    (tmp_path / "mine.py").write_text(POLICY.replace("GATE", str(gate)))
    process = subprocess.Popen(
        command(suite, tmp_path / "nodes", "--address", cluster.address), env={**os.environ, "OMP_NUM_THREADS": "1"}
    )

    def wait_until(condition):
        deadline = time.monotonic() + 240
        while not condition():
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.2)

    try:
        wait_until((tmp_path / "nodes" / RUN_FILE).exists)
        second = cluster.add_node(num_cpus=1)
        wait_until(lambda: workers_on(second))
        cluster.remove_node(second, allow_graceful=False)
        gate.touch()
        assert process.wait(240) == 0
    finally:
        process.kill()
        process.wait()
    subprocess.run(command(suite, tmp_path / "undisturbed"), check=True)
    disturbed, undisturbed = read_run(tmp_path / "nodes"), read_run(tmp_path / "undisturbed")
    assert disturbed.status is RunStatus.COMPLETE
    assert disturbed.rows_hash == undisturbed.rows_hash
