"""Commands in new processes that import this repository's package."""

import contextlib
import os
import subprocess
import sys

import psutil

from tests import ROOT

GAUNTLET = [sys.executable, "-c", "from robogauntlet.orchestrator.cli import main; main()"]
"""The `robogauntlet` command."""


def environment_of(*paths, **variables):
    """The environment of a command with further folders of modules and variables."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (ROOT / "src", *paths))), **variables}


def run_process(command, cwd=ROOT, *, paths=(), timeout=300, **variables):
    """Run a command with further folders of modules and variables; return its exit code and output."""
    environment, words = environment_of(*paths, **variables), [*map(str, command)]
    return subprocess.run(words, capture_output=True, text=True, timeout=timeout, cwd=cwd, env=environment, check=False)


def run_gauntlet(*arguments, **options):
    """Run `robogauntlet ...` as `run_process` does."""
    return run_process([*GAUNTLET, *arguments], **options)


def started_by(command, words=""):
    """The processes below `command` with these words in their command line, without those that end meanwhile."""
    found = []
    with contextlib.suppress(psutil.NoSuchProcess):
        for child in psutil.Process(command.pid).children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                found += [child] if words in " ".join(child.cmdline()) else []
    return found


def listening_addresses(command):
    """The IP addresses on which the command, a psutil.Process, and all that it started listen."""
    found = set()
    for process in (command, *started_by(command)):
        with contextlib.suppress(psutil.NoSuchProcess):
            ask = process.net_connections if hasattr(process, "net_connections") else process.connections  # psutil 5
            sockets = ask("inet")
            found |= {
                socket.laddr.ip.removeprefix("::ffff:") for socket in sockets if socket.status == psutil.CONN_LISTEN
            }
    return found
