"""Commands in new processes that import this repository's package."""

import os
import subprocess
import sys

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
