"""Pages of the documentation that tests follow: the files and commands in their blocks."""

import os
import re
import shlex
import signal
import subprocess
import sys
from contextlib import ExitStack, contextmanager

from tests import ROOT
from tests.processes import GAUNTLET, environment_of, run_process

BLOCK = re.compile(
    r'^```(?:\w+ title="(?P<path>[^"]+)"|(?P<console>console))\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL
)
PROGRAMS = {"robogauntlet": GAUNTLET, "python": [sys.executable]}


def blocks(page, section=""):
    """The blocks of a page in `docs`, or of its section: a file's path and text, or None and the lines of commands."""
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    if section:
        text = text.split(f"\n## {section}\n")[1].partition("\n## ")[0]
    return [(block["path"], block["text"]) for block in BLOCK.finditer(text)]


def follow(page, section, folder, *, skipped=(), replaced=(), **variables):
    """Do what a section of a page says, in an empty folder: write its files and run its commands, which must succeed.

    A command that ends in `&` runs until the section ends; the next one waits for its first line.

    Args:
        page: Name of the page.
        section: Heading of the section.
        folder: Where its reader starts; `cd` changes it.
        skipped: Beginnings of commands that are not run.
        replaced: Pairs of a text of the page and what the test has instead of it.
        variables: Environment variables of the commands.

    Returns:
        Command to what it printed, in order.
    """
    printed = {}
    with ExitStack() as running:
        for path, text in blocks(page, section):
            for old, new in replaced:
                text = text.replace(old, new)
            if path is not None:
                (folder / path).write_text(text, encoding="utf-8")
                continue
            for line in text.splitlines():
                if line.startswith(tuple(skipped)):
                    continue
                program, *arguments = shlex.split(line, comments=True)
                if program == "cd":
                    folder /= arguments[0]
                elif arguments[-1:] == ["&"]:
                    command = [*PROGRAMS[program], *arguments[:-1]]
                    printed[line] = running.enter_context(_in_background(command, folder, variables))
                else:
                    done = run_process([*PROGRAMS[program], *arguments], folder, **variables)
                    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
                    printed[line] = done.stdout
    return printed


@contextmanager
def _in_background(command, folder, variables):
    """Run a command; yields the first line that it prints."""
    environment = environment_of(**variables, PYTHONUNBUFFERED="1")
    with (folder / "background.log").open("w") as log:
        process = subprocess.Popen(
            [*map(str, command)], cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=log, text=True
        )
    try:
        line = process.stdout.readline()
        assert line, (folder / "background.log").read_text()
        yield line
    finally:
        os.kill(process.pid, signal.SIGTERM)
        process.stdout.close()
        process.wait(30)
