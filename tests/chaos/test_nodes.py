"""A run on a Ray cluster that a node joins, and then dies."""

import os
import subprocess
import sys
import time

import psutil
import pytest
from ray.cluster_utils import Cluster

from robogauntlet.results.run_document import RUN_FILE, RunStatus, read_run
from robogauntlet.results.store.episode_store import Store
from tests.chaos.suites import NULL

pytestmark = [pytest.mark.ray, pytest.mark.slow]


@pytest.fixture
def cluster():
    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    yield nodes
    nodes.shutdown()


def command(suite, folder, *more):
    program = "import sys; from robogauntlet.orchestrator.cli import main; main()"
    return [sys.executable, "-c", program, "run", str(suite), "--out", str(folder), "--no-media", *more]


def stored_rows(folder):
    """Number of stored episodes; 0 before the run has started, as its document is written last."""
    if not (folder / RUN_FILE).exists():
        return 0
    store = Store.open_file(folder / "episodes.sqlite", read_run(folder).run_id)
    count = sum(store.status_counts().values())
    store.close()
    return count


def workers_on(node):
    """Processes of workers that play on a node of this machine."""
    (raylet,) = node.all_processes["raylet"]
    return [
        process
        for process in psutil.process_iter(["ppid", "cmdline"])
        if process.info["ppid"] == raylet.process.pid and "ray::Worker.play" in " ".join(process.info["cmdline"] or ())
    ]


def test_a_node_that_joins_gets_workers_and_its_death_changes_no_row(cluster, tmp_path):
    suite = tmp_path / "suite.yaml"
    suite.write_text(NULL.replace("workers: 2", "workers: auto").replace("count: 120", "count: 100"))
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
        wait_until(lambda: stored_rows(tmp_path / "nodes") > 20)
        second = cluster.add_node(num_cpus=1)
        wait_until(lambda: workers_on(second))
        cluster.remove_node(second, allow_graceful=False)
        assert process.wait(240) == 0
    finally:
        process.kill()
        process.wait()
    subprocess.run(command(suite, tmp_path / "undisturbed"), check=True)
    disturbed, undisturbed = read_run(tmp_path / "nodes"), read_run(tmp_path / "undisturbed")
    assert disturbed.status is RunStatus.COMPLETE
    assert disturbed.rows_hash == undisturbed.rows_hash
