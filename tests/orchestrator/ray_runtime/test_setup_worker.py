"""What stands in for the script with which Ray starts a worker."""

import json
import os
import subprocess
import sys

import psutil
import pytest
from ray._private import ray_constants
from ray._private.runtime_env.context import RuntimeEnvContext
from ray.core.generated.common_pb2 import Language

from robogauntlet.orchestrator.ray_runtime import setup_worker
from robogauntlet.orchestrator.ray_runtime.parts import without_unused_parts
from robogauntlet.orchestrator.ray_runtime.session import ray_session
from tests.processes import started_by

WORKER = """
import json, os, sys
print(json.dumps([os.getpid(), sys.argv[1:], os.environ["NAME"]]))
"""


class Replaced(Exception):
    """This process would be another one now."""


@pytest.mark.parametrize(
    "context",
    [
        {},
        {"env_vars": {"HERE": "${PLACE}/a b", "NOTHING": "[${UNKNOWN_NAME}]", "TWICE": "${HERE}"}},
        {"py_executable": "/elsewhere/bin/python -X utf8"},
        {"command_prefix": ["cd", "/tmp", "&&"], "override_worker_entrypoint": "/image/a worker.py"},
    ],
    ids=["nothing", "variables", "interpreter", "container"],
)
def test_it_does_what_rays_own_does(context, monkeypatch):
    def replace(file, args):
        raise Replaced(file, args)

    monkeypatch.setattr(os, "execvp", replace)
    monkeypatch.setattr(os, "environ", {"PLACE": "/there"})
    words = ["/ray/worker.py", "--node-ip-address=127.0.0.1", "--name=it's $HOME"]
    with pytest.raises(Replaced) as expected:
        RuntimeEnvContext.deserialize(json.dumps(context)).exec_worker(words, Language.PYTHON)
    variables = dict(os.environ)
    monkeypatch.setattr(os, "environ", {"PLACE": "/there"})
    with pytest.raises(Replaced) as found:
        setup_worker.become_worker(
            [*words, f"--serialized-runtime-env-context={json.dumps(context)}", "--language=PYTHON"]
        )
    assert found.value.args == expected.value.args
    assert os.environ == variables


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """Id of a process that runs the script, what the worker prints, and the modules that are imported in between."""
    (worker := tmp_path_factory.mktemp("worker") / "worker.py").write_text(WORKER)
    context = json.dumps({"env_vars": {"NAME": "a value"}})
    words = [str(worker), "--port=1 2", f"--serialized-runtime-env-context={context}", "--language=PYTHON"]
    command = [sys.executable, "-X", "importtime", setup_worker.__file__, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        out, err = process.communicate()
    return process.pid, json.loads(out), {line.rpartition("|")[2].strip() for line in err.splitlines()}


def test_the_process_becomes_the_worker(started):
    assert started[1] == [started[0], ["--port=1 2"], "a value"]


def test_ray_is_not_imported_before_the_worker(started):
    assert "json" in started[2]
    assert not {"ray", "ray._raylet"} & started[2]


@pytest.mark.ray
def test_a_session_starts_its_workers_by_it():
    with ray_session(address=None, workers=1):
        assert [part.name() for part in started_by(psutil.Process(), setup_worker.__file__)] == ["raylet"]


@pytest.mark.parametrize(("version", "file"), [("2.60.3", setup_worker.__file__), ("2.61.0", "setup_worker.py")])
def test_only_the_known_version_of_ray_is_given_it_and_only_meanwhile(version, file, monkeypatch):
    monkeypatch.setattr("ray.__version__", version)
    with without_unused_parts():
        given = ray_constants.SETUP_WORKER_FILENAME
    assert (given, ray_constants.SETUP_WORKER_FILENAME) == (file, "setup_worker.py")
