"""How many workers fit a Ray, and who can reach it."""

import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.ray_runtime import session as session_module
from robogauntlet.orchestrator.ray_runtime.private_names import _get_node, private, quick_start, replaced
from robogauntlet.orchestrator.ray_runtime.session import (
    WORKER_BYTES,
    RayLost,
    free_resources,
    in_session,
    keep_token,
    ray_session,
    room_for_workers,
    temporary_folder,
    workers_that_fit,
)
from tests.processes import run_process


def test_a_ray_without_the_private_names_is_used_by_its_public_ones(monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.ray_runtime.private_names.private_module", lambda name: None)
    nodes = [{"NodeID": "a", "Alive": True, "Resources": {"CPU": 2.0}}, {"NodeID": "b", "Alive": False}]
    monkeypatch.setattr("ray.nodes", lambda: nodes)
    assert free_resources() == {"a": {"CPU": 2.0}}
    with quick_start():
        pass
    assert _get_node(lambda address, node: (address, node), "127.0.0.1:1", "a") == ("127.0.0.1:1", "a")
    with replaced("_private.utils", "set_sigterm_handler", None):
        assert private("_private.utils", "set_sigterm_handler") is None


@pytest.mark.parametrize(
    ("resources", "workers"),
    [
        ({"CPU": 8.0, "memory": 100.0 * WORKER_BYTES}, 8),
        ({"CPU": 8.0, "memory": 3.9 * WORKER_BYTES}, 3),
        ({"CPU": 8.0}, 8),
        ({"CPU": 0.5, "memory": 0.5 * WORKER_BYTES}, 1),
    ],
)
def test_workers_fit_cores_and_memory_and_are_at_least_one(resources, workers, monkeypatch):
    monkeypatch.setattr("ray.cluster_resources", lambda: resources)
    assert room_for_workers() == workers


@pytest.mark.parametrize(
    ("free", "options", "workers"),
    [
        ({"CPU": 3.0, "memory": 1.0}, {"num_cpus": 1.0, "num_gpus": 0.0}, 3),
        ({"CPU": 3.0}, {"num_cpus": 2.0}, 1),
        ({"CPU": 3.0, "GPU": 1.0}, {"num_cpus": 0.5, "num_gpus": 0.25}, 4),
        ({"CPU": 3.0}, {"num_cpus": 1.0, "num_gpus": 0.5}, 0),
        ({"CPU": 8.0, "memory": 5.0}, {"num_cpus": 1.0, "memory": 2}, 2),
        ({}, {"num_cpus": 1.0}, 0),
    ],
)
def test_the_scarcest_resource_of_a_node_decides_how_many_workers_fit(free, options, workers):
    assert workers_that_fit(free, options) == workers


SESSION = """
import collections, json, os, psutil, ray, time
from ray._private import utils, worker
from robogauntlet.orchestrator.ray_runtime.session import ray_session
from tests.processes import listening_addresses

before = {name: value for name, value in os.environ.items() if name.startswith("RAY_")}
with ray_session(address=None, workers=1):
    token = os.environ["RAY_AUTH_MODE"]
    actor = ray.remote(collections.Counter).remote()
    ray.get(actor.total.remote())
    listening = listening_addresses(psutil.Process())
    parts = [part.cmdline() for part in psutil.Process().children(recursive=True)]
    utils.publish_error_to_driver("node", "Raylet is terminated", gcs_client=worker.global_worker.gcs_client)
    time.sleep(2)
same = before == {name: value for name, value in os.environ.items() if name.startswith("RAY_")}
found = {"mode": token, "listening": sorted(listening), "environment as before": same}
idle = ("monitor.py", "dashboard.py")
found["idle"] = [part for part in parts if any(word.endswith(idle) for word in part)]
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def session():
    """The end of a process that has a session on this machine, in which a worker runs and Ray says that it ends."""
    return run_process([sys.executable, "-c", SESSION], RAY_AUTH_MODE="disabled")


@pytest.mark.ray
def test_ray_of_one_machine_listens_on_loopback_with_a_token_and_leaves_the_environment_as_it_was(session):
    found = json.loads(session.stdout.splitlines()[-1])
    assert (found["mode"], found["listening"], found["environment as before"]) == ("token", ["127.0.0.1"], True)


@pytest.mark.ray
def test_ray_of_one_machine_starts_no_process_that_nothing_uses(session):
    assert json.loads(session.stdout.splitlines()[-1])["idle"] == []


def test_parameters_of_ray_with_other_names_are_left_alone(monkeypatch):
    other = lambda **_: None  # noqa: E731
    monkeypatch.setattr("ray._private.parameter.RayParams", other)
    with quick_start():
        assert private("_private.parameter", "RayParams") is other


@pytest.mark.ray
def test_messages_of_ray_about_its_processes_are_not_shown(session):
    assert len(session.stdout.splitlines()) == 1
    assert session.stderr == ""


FAILING = """
import psutil, ray._private.services as services
from robogauntlet.orchestrator.ray_runtime.session import RayLost, ray_session

def get_node(*_):
    raise Exception("The current node timed out during startup.\\nMore")

services.get_node = get_node
try:
    with ray_session(address=None, workers=1):
        pass
except RayLost as error:
    print(error)
print([child.name() for child in psutil.Process().children()])
"""


@pytest.mark.ray
def test_a_ray_that_does_not_start_is_lost_and_leaves_no_process():
    done = subprocess.run([sys.executable, "-c", FAILING], check=True, capture_output=True, text=True, timeout=120)
    assert done.stdout.splitlines()[-2:] == ["Ray did not start: The current node timed out during startup.", "[]"]


def test_after_a_start_that_failed_ray_is_started_as_it_is(monkeypatch):
    own, is_own = private("_private.services", "start_api_server"), []

    def init(*_, **__):
        is_own.append(private("_private.services", "start_api_server") is own)
        if len(is_own) == 1:
            raise ValueError("too many values to unpack (expected 2)")

    monkeypatch.setattr("ray.init", init)
    monkeypatch.setattr(session_module, "_has_failed", False)
    with pytest.raises(RayLost, match="Ray did not start: too many values"):
        session_module._start(None, 1)
    session_module._start(None, 1)
    assert is_own == [False, True]


@pytest.mark.ray
def test_the_token_of_ray_is_for_its_owner_only(ray_here):
    assert (Path.home() / ".ray" / "auth_token").stat().st_mode & 0o077 == 0


def test_sessions_that_start_at_once_on_a_new_machine_have_one_token(tmp_path):
    folder, together = tmp_path / "new" / ".ray", threading.Barrier(8)

    def token(_):
        together.wait()
        keep_token(folder)
        return (folder / "auth_token").read_text()

    with ThreadPoolExecutor(8) as threads:
        tokens = set(threads.map(token, range(8)))
    assert len(tokens) == 1
    assert [path.name for path in folder.iterdir()] == ["auth_token"]
    assert (folder / "auth_token").stat().st_mode & 0o077 == 0


def test_a_token_that_is_there_is_kept_for_its_owner_only(tmp_path):
    (tmp_path / "auth_token").write_text("mine")
    (tmp_path / "auth_token").chmod(0o644)
    keep_token(tmp_path)
    assert (tmp_path / "auth_token").read_text() == "mine"
    assert (tmp_path / "auth_token").stat().st_mode & 0o077 == 0


@pytest.mark.ray
def test_a_session_in_another_leaves_the_variables_by_which_processes_join(ray_here):
    before = dict(os.environ)
    with ray_session(address=None, workers=1):
        assert dict(os.environ) == before
    assert before["RAY_AUTH_MODE"] == "token"


@pytest.mark.ray
def test_a_process_whose_variables_ray_was_started_with_is_not_set_up_and_has_them(ray_here):
    import ray

    given = EnvironmentResolver().shared_variables(["null", "pybullet"])
    assert in_session({"env_vars": given}) == {}
    assert in_session({"env_vars": {**given, "MUJOCO_GL": "glx"}}) == {"env_vars": {"MUJOCO_GL": "glx"}}
    assert in_session({"env_vars": {"PATH": os.environ["PATH"]}}) == {}
    names = ("TMPDIR", *given)
    found = ray.get(ray.remote(num_cpus=0)(lambda: [os.environ.get(name) for name in names]).remote())
    assert found == [str(temporary_folder()), *given.values()]


def test_simulators_share_the_variables_that_do_not_differ():
    assert EnvironmentResolver().shared_variables(["robosuite"])["MUJOCO_GL"] == "egl"
    assert "MUJOCO_GL" not in EnvironmentResolver().shared_variables(["robosuite", "pybullet"])
    assert EnvironmentResolver().shared_variables([]) == {}
