"""A Ray cluster of three nodes that differ and fail, against one machine: the same rows, and no end without a word."""

import contextlib
import os
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import psutil
import pytest

from robogauntlet.results.record import outcome_row
from robogauntlet.results.run_document import RUN_FILE, RunStatus, read_run
from robogauntlet.results.store.episode_store import Store
from tests.chaos.cluster_nodes import ray_cluster, why_not
from tests.chaos.suites import NULL

pytestmark = [pytest.mark.ray, pytest.mark.chaos]
PROGRAM = "import sys; from robogauntlet.orchestrator.cli import main; main()"
POLICY = '''
import os
import time
from pathlib import Path

import numpy as np

GAIN = float(Path(__file__).with_name("gain.txt").read_text())


def policy(images, proprioception, instruction):
    """Move by a constant; wait for the file that the environment names, at most 60 s."""
    gate, until = os.environ.get("TEST_GATE"), time.monotonic() + 60
    while gate and time.monotonic() < until and not Path(gate).exists():
        time.sleep(0.2)
    return np.full((60, 7), GAIN)
'''
SUITE = """
name: nodes
policies:
  - oracle
  - name: constant
    kind: python
    options: {callable: "mine:policy", folder: FOLDER, files: [gain.txt]}
tasks: [null/Slow, pybullet/PandaReach-v3]
cameras: [third_person]
image_size: 64
seeds: {count: 20}
episode_time_limit_s: 600
"""
WAIT_S = 900.0
"""Time for anything to happen (s); a busy machine takes several times as long as a quiet one."""
CUT_OFF_S = 60.0
"""Time that a node is cut off (s). The head gives it up after 15 to 65 s."""


@pytest.fixture(scope="module")
def namespaces():
    if (reason := why_not()) is not None:
        pytest.skip(reason)


def command(suite, folder, *more):
    return [sys.executable, "-c", PROGRAM, "run", str(suite), "--out", str(folder), "--no-media", *more]


def stored_rows(folder):
    if not (folder / RUN_FILE).exists():
        return []
    store = Store.open_file(folder / "episodes.sqlite", read_run(folder).run_id)
    rows = list(store.results())
    store.close()
    return rows


def outcomes(folder):
    return {outcome_row(row) for row in stored_rows(folder)}


def wait_until(process, log, condition):
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.3)


def plays(node):
    """Whether a worker plays on a node."""
    for process in node.processes():
        with contextlib.suppress(psutil.Error):
            if process.cmdline()[:1] == ["ray::Worker.play"]:
                return True
    return False


def an_hour_ahead(folder):
    """Environment variables of Python processes whose clock is an hour ahead."""
    folder.mkdir()
    lines = ["import time", "now, now_ns = time.time, time.time_ns", "time.time = lambda: now() + 3600"]
    lines += ["time.time_ns = lambda: now_ns() + 3600 * 10**9"]
    (folder / "sitecustomize.py").write_text("\n".join(lines))
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])}


def test_nodes_that_differ_and_fail_change_no_row(namespaces, tmp_path):
    """The second and third node lack the policy's files and a simulator; the third's clock is wrong.

    The second is killed, the third cut off for a time and started again.
    """
    policy = tmp_path / "policy"
    policy.mkdir()
    (policy / "mine.py").write_text(POLICY)
    (policy / "gain.txt").write_text("0.3")
    suite, folder, log = tmp_path / "suite.yaml", tmp_path / "nodes", tmp_path / "log.txt"
    suite.write_text(SUITE.replace("FOLDER", str(policy)))
    package = Path(find_spec("panda_gym").origin).parent
    own = [Path("/tmp") / "robogauntlet-0"]  # where a node keeps copies of policies
    with ray_cluster(tmp_path, private=own) as cluster:
        gate = tmp_path / "gate"  # until it exists, the run cannot end
        cluster.environment["TEST_GATE"] = str(gate)
        clock = an_hour_ahead(tmp_path / "clock")
        for number in (1, 2):
            scratch = tmp_path / f"scratch{number}"
            scratch.mkdir()
            cluster.nodes[number].without_package(package, scratch)
            cluster.nodes[number].run("mount", "-t", "tmpfs", "tmpfs", str(policy))
        for number in range(3):
            cluster.start_ray(number, cpus=2 if number == 0 else 1, more=clock if number == 2 else None)
        process = cluster.popen(0, command(suite, folder, "--address", cluster.address), log)
        _, second, third = cluster.nodes
        wait_until(process, log, lambda: plays(second))
        second.kill()
        wait_until(process, log, lambda: plays(third))
        cluster.cut(2, off=True)
        time.sleep(CUT_OFF_S)
        cluster.cut(2, off=False)
        assert process.poll() is None, log.read_text()
        third.kill()  # as a supervisor does with a raylet that the head has given up
        cluster.start_ray(2, more=clock)
        wait_until(process, log, lambda: plays(third))  # a node that joins gets workers
        gate.touch()
        assert process.wait(WAIT_S) == 0, log.read_text()
    subprocess.run(command(suite, tmp_path / "one"), check=True, stdout=subprocess.DEVNULL)
    several, one = read_run(folder), read_run(tmp_path / "one")
    assert several.status is RunStatus.COMPLETE
    assert outcomes(folder) ^ outcomes(tmp_path / "one") == set()
    assert several.rows_hash == one.rows_hash


def test_the_death_of_the_head_ends_a_run_with_a_message_and_it_continues_elsewhere(namespaces, tmp_path):
    suite, folder, log = tmp_path / "suite.yaml", tmp_path / "nodes", tmp_path / "log.txt"
    suite.write_text(NULL.replace("count: 120", "count: 60").replace("workers: 2", "workers: auto"))
    with ray_cluster(tmp_path, nodes=2) as cluster:
        cluster.start_ray(0)
        cluster.start_ray(1)
        process = cluster.popen(1, command(suite, folder, "--address", cluster.address), log)
        wait_until(process, log, lambda: len(stored_rows(folder)) > 20)
        cluster.nodes[0].kill()
        assert process.wait(120) == 3
    text = log.read_text()
    assert f"the head of the cluster at {cluster.address} has not answered for 20 s" in text
    assert "continue with: robogauntlet resume" in text
    assert read_run(folder).status is RunStatus.STOPPED
    subprocess.run(command(suite, folder), check=True, stdout=subprocess.DEVNULL)
    subprocess.run(command(suite, tmp_path / "one"), check=True, stdout=subprocess.DEVNULL)
    assert read_run(folder).rows_hash == read_run(tmp_path / "one").rows_hash
