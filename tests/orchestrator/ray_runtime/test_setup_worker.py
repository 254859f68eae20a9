"""What stands in for the script with which Ray starts a worker."""

import json
import os
import subprocess
import sys

import psutil
import pytest
from ray._private.runtime_env.context import RuntimeEnvContext
from ray.core.generated.common_pb2 import Language

from robogauntlet.orchestrator.ray_runtime import setup_worker
from robogauntlet.orchestrator.ray_runtime.session import ray_session

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
        {"command_prefix": ["cd", "/tmp", "&&"], "override_worker_entrypoint": "/image/worker.py"},
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


def test_the_process_becomes_the_worker_and_has_not_imported_ray(tmp_path):
    (worker := tmp_path / "worker.py").write_text(WORKER)
    context = json.dumps({"env_vars": {"NAME": "a value"}})
    words = [str(worker), "--port=1 2", f"--serialized-runtime-env-context={context}", "--language=PYTHON"]
    command = [sys.executable, "-X", "importtime", setup_worker.__file__, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        out, err = process.communicate()
    assert json.loads(out) == [process.pid, ["--port=1 2"], "a value"]
    assert " json" in err
    assert not any(line.split("|")[-1].strip() == "ray" for line in err.splitlines())


@pytest.mark.ray
def test_a_session_starts_its_workers_by_it():
    with ray_session(address=None, workers=1):
        commands = [process.cmdline() for process in psutil.Process().children() if process.name() == "raylet"]
        assert [setup_worker.__file__ in " ".join(command) for command in commands] == [True]
