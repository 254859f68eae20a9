"""The Slurm script of the examples, on a controller and two slurmd of Debian's packages."""

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from robogauntlet.results.run_document import RUN_FILE, RunStatus, read_run
from tests.chaos.cluster_nodes import ray_cluster, why_not
from tests.chaos.suites import NULL

pytestmark = [pytest.mark.ray, pytest.mark.chaos]
PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch")
SCRIPT = Path(__file__).parents[2] / "examples" / "slurm.sbatch"
CONFIGURATION = """
ClusterName=test
SlurmctldHost=node1(10.77.0.1)
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=FOLDER/munge.socket
StateSaveLocation=FOLDER/state
SlurmdSpoolDir=FOLDER/spool-%n
SlurmctldPidFile=FOLDER/slurmctld.pid
SlurmdPidFile=FOLDER/slurmd-%n.pid
SlurmctldLogFile=FOLDER/slurmctld.log
SlurmdLogFile=FOLDER/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
NodeName=node1 NodeAddr=10.77.0.1 CPUs=1 State=UNKNOWN
NodeName=node2 NodeAddr=10.77.0.2 CPUs=1 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""

LATE = """#!/bin/bash
[[ $SLURM_NODEID != 0 || $1 != symmetric-run ]] || sleep 20
exec RAY "$@"
"""
"""The command `ray` that starts late on the head, as from a slow file system: Ray alone would give up before."""


@pytest.fixture
def short_folder():
    """A folder for Slurm's sockets: a path of more than 107 bytes would be none."""
    with tempfile.TemporaryDirectory(prefix="slurm-") as name:
        yield Path(name)


@pytest.fixture
def cluster(tmp_path, short_folder):
    # Slurm's controller may outlive `nsenter`: its folder is removed when its node has ended.
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed: apt-get install munge slurmctld slurmd slurm-client")
    if (reason := why_not()) is not None:
        pytest.skip(reason)
    with ray_cluster(tmp_path, nodes=2) as nodes:
        yield nodes


def start_slurm(cluster, folder, stack):
    """Start munge, a controller on the first node and slurmd on both; wait until both nodes are idle."""
    folder.chmod(0o755)
    (folder / "state").mkdir()
    for node in cluster.nodes:
        (folder / f"spool-{node.name}").mkdir()
    configuration, hosts = folder / "slurm.conf", folder / "hosts"
    configuration.write_text(CONFIGURATION.replace("FOLDER", str(folder)))
    hosts.write_text("127.0.0.1 localhost\n" + "".join(f"{node.address} {node.name}\n" for node in cluster.nodes))
    key = folder / "munge.key"
    key.write_bytes(os.urandom(64))
    key.chmod(0o400)
    shutil.chown(key, "root")
    cluster.environment["SLURM_CONF"] = str(configuration)
    cluster.environment["RAY_gcs_rpc_server_reconnect_timeout_s"] = "5"
    programs = Path(sys.executable).parent
    (late := folder / "late").mkdir()
    (late / "ray").write_text(LATE.replace("RAY", str(programs / "ray")))
    (late / "ray").chmod(0o755)
    cluster.environment["PATH"] = f"{late}:{programs}:{os.environ['PATH']}"
    munge = ["munged", "--foreground", "--force", f"--socket={folder / 'munge.socket'}", f"--key-file={key}"]
    munge += [f"--pid-file={folder / 'munge.pid'}", f"--log-file={folder / 'munge.log'}"]
    munge += [f"--seed-file={folder / 'munge.seed'}"]
    for node in cluster.nodes:
        node.run("mount", "--bind", str(hosts), "/etc/hosts")
    commands = [(0, munge), (0, ["slurmctld", "-D"]), *((n, ["slurmd", "-D", "-N", f"node{n + 1}"]) for n in (0, 1))]
    for number, command in commands:
        process = cluster.popen(number, command, folder / f"{command[0]}.out")
        stack.callback(process.wait)
        stack.callback(process.kill)
        time.sleep(1.0)
    deadline = time.monotonic() + 60
    while (states := slurm(cluster, "sinfo", "--noheader", "--format=%t %D")) != "idle 2":
        assert time.monotonic() < deadline, states
        time.sleep(0.5)


def slurm(cluster, *command, timeout_s=60.0):
    done = subprocess.run(
        cluster.nodes[0].inside("timeout", str(timeout_s), *command),
        env=cluster.environment,
        capture_output=True,
        text=True,
    )
    return (done.stdout + done.stderr).strip()


def test_the_script_plays_a_suite_on_all_nodes_of_a_job(cluster, short_folder, tmp_path):
    suite, folder = tmp_path / "suite.yaml", tmp_path / "run"
    suite.write_text(NULL.replace("count: 120", "count: 30").replace("workers: 2", "workers: auto"))
    with contextlib.ExitStack() as stack:
        start_slurm(cluster, short_folder, stack)
        log = tmp_path / "job.log"
        options = [f"--output={log}", f"--chdir={tmp_path}", "--wait"]
        arguments = [str(SCRIPT), str(suite), "--out", str(folder), "--no-media"]
        answer = slurm(cluster, "sbatch", *options, *arguments, timeout_s=600.0)
    answer += log.read_text() if log.exists() else ""
    assert (folder / RUN_FILE).exists(), answer
    document = read_run(folder)
    assert document.status is RunStatus.COMPLETE, answer
    assert document.shared_workers == 2
