"""Ctrl-C ends a command at any instant of its start, also where Python drops exceptions."""

import subprocess
import sys
from signal import SIGINT, SIGTERM

import pytest

from tests.processes import environment_of

SEND = "os.kill(os.getpid(), NUMBER)"
IN_A_DESTRUCTOR = f"type('Dropping', (), {{'__del__': lambda self: [{SEND}, *range(1000)]}})()"
PROGRAM = """
import os, sys, time
def interrupt(event, arguments):
    if event == "import" and arguments[0] == NAME and not sent:
        sent.append(True)
        SENDING
def start():
    import ray
    time.sleep(20)
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
    words = [sys.executable, "-c", program, "list"]
    done = subprocess.run(words, env=environment_of(), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert "Traceback" not in done.stderr
