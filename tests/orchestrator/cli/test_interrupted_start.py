"""Ctrl-C ends a command while it starts, from its first own line on, also where Python drops exceptions."""

import ast
import subprocess
import sys
from signal import SIGINT, SIGTERM

import psutil
import pytest

from tests.jobs import mostly_nightly
from tests.processes import environment_of

SEND = "os.kill(os.getpid(), NUMBER)"
IN_A_DESTRUCTOR = f"type('Dropping', (), {{'__del__': lambda self: [{SEND}, *range(1000)]}})()"
PROGRAM = """
import os, sys
def interrupt(event, arguments):
    if event == "import" and arguments[0] == NAME and not sent:
        sent.append(True)
        SENDING
def start():
    import ray
    print("went on")
sent = []
sys.addaudithook(interrupt)
from robogauntlet.orchestrator.cli import main
if NAME != "typer":
    from robogauntlet.orchestrator.cli import verbs
    verbs.run_command = start
main()
"""
INSTANTS = [
    ("typer", SEND, SIGINT),
    ("ray", SEND, SIGTERM),
    ("ray._raylet", SEND, SIGINT),
    ("typer", IN_A_DESTRUCTOR, SIGTERM),
    ("ray", IN_A_DESTRUCTOR, SIGINT),
    ("ray._raylet", IN_A_DESTRUCTOR, SIGTERM),
    ("ray._private.worker", IN_A_DESTRUCTOR, SIGINT),
]


@pytest.mark.parametrize(("name", "sending", "number"), INSTANTS)
def test_an_interruption_ends_a_command_while_this_is_imported(name, sending, number):
    program = PROGRAM.replace("SENDING", sending).replace("NAME", repr(name)).replace("NUMBER", str(int(number)))
    words = [sys.executable, "-c", program, "list", "tasks"]
    done = subprocess.run(words, env=environment_of(), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert "Traceback" not in done.stderr


RAY_STARTS = """
import os, psutil, ray
from ray._private.node import Node
from robogauntlet.orchestrator.cli import main, verbs
from robogauntlet.orchestrator.ray_runtime.session import ray_session
start_parts = Node.start_ray_processes
def start(node):
    start_parts(node)
    print([process.pid for process in psutil.Process().children(recursive=True)], flush=True)
    os.kill(os.getpid(), NUMBER)
    print("went on")
def run():
    with ray_session(address=None, workers=1):
        print("started")
Node.start_ray_processes = start
verbs.run_command = run
main()
"""


@pytest.mark.ray
@pytest.mark.parametrize("number", mostly_nightly([SIGINT, SIGTERM], [SIGTERM]))
def test_an_interruption_ends_a_command_while_ray_starts_and_leaves_no_process(number):
    words = [sys.executable, "-c", RAY_STARTS.replace("NUMBER", str(int(number)))]
    done = subprocess.run(words, env=environment_of(), capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    (line,) = done.stdout.splitlines()
    started = [process for process in psutil.process_iter() if process.pid in ast.literal_eval(line)]
    _, left = psutil.wait_procs(started, 60)
    assert left == []


BEFORE_THE_FIRST_ROW = """
import os, signal
from robogauntlet.orchestrator.cli import main
import robogauntlet.orchestrator.runs.run as run
run.import_ray = lambda: os.kill(os.getpid(), signal.SIGINT)
main()
"""


def test_a_run_that_is_interrupted_before_its_first_row_writes_no_report_and_can_be_continued(tmp_path):
    words = ["run", "null/Reach", "--policy", "random", "--seeds", "5", "--no-media", "--out", "run"]
    command, options = [sys.executable, "-c", BEFORE_THE_FIRST_ROW, *words], {"cwd": tmp_path, "env": environment_of()}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)
    assert done.returncode == 130
    assert "interrupted; continue with: robogauntlet resume run" in done.stderr
    assert "report" not in done.stdout
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"run.json", "episodes.sqlite"}
    assert not (tmp_path / "run" / "report.html").exists()
