"""The commands of the script that makes the zoo, which takes hours, and those of pages are valid."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
import typer

from robogauntlet.orchestrator.cli import app
from tests import ROOT

SCRIPT = ROOT / "scripts/zoo.sh"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "studies").glob("*/README.md"))]
COMMAND = re.compile(r"^(?:    |\$ )?robogauntlet (.*)$", re.MULTILINE)
# Replaces the command line: writes the arguments of each call into a line of a file.
RECORDER = """#!/usr/bin/env bash
line=$(printf '%s\\t' "$@")
echo "$line" >>"${0%/*}/commands"
"""


def commands_of(script: Path, folder: Path, *words: str, percent: str | None = None) -> list[list[str]]:
    """The commands of a script that starts in an empty folder, with further words; they are recorded and not run.

    Raises:
        subprocess.CalledProcessError: The script ended with an error.
    """
    for name, text in {"robogauntlet": RECORDER, "python": "#!/bin/sh\n"}.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    environment = {**os.environ, "ROBOGAUNTLET": str(folder / "robogauntlet")}
    environment.pop("PERCENT", None)
    if percent is not None:
        environment["PERCENT"] = percent
    (folder / "out").mkdir()
    command = ["bash", str(script), str(folder / "out"), *words]
    subprocess.run(command, check=True, capture_output=True, text=True, env=environment, timeout=60)
    return [line.rstrip("\t").split("\t") for line in (folder / "commands").read_text().splitlines()]


def parsed(arguments: Sequence[str]) -> dict[str, object]:
    """The values of a command's options as the command line parses them.

    Raises:
        click.UsageError: The command line does not accept an argument.
    """
    command, context = typer.main.get_command(app), None
    rest = list(arguments)
    while True:
        context = command.make_context(command.name, rest, parent=context)
        if not hasattr(command, "resolve_command"):
            return context.params
        _, command, rest = command.resolve_command(context, [*context._protected_args, *context.args])


def test_every_command_that_makes_the_zoo_is_valid(tmp_path: Path) -> None:
    commands = commands_of(SCRIPT, tmp_path)
    for command in commands:
        parsed(command)
    assert len(commands) == 24


def test_percent_uses_that_share_and_at_least_three_demonstrations(tmp_path: Path) -> None:
    options = [parsed(command) for command in commands_of(SCRIPT, tmp_path, percent="1")]
    assert {values["episodes"] for values in options if "episodes" in values} == {3, 4, 5, 6, 20}
    assert {values["steps"] for values in options if "steps" in values} == {13, 15, 18, 32, 40, 50, 90, 200}


@pytest.mark.parametrize("percent", ["0", "-1", "half", "1000", "1.5"])
def test_a_share_that_is_no_whole_percent_is_refused_first(percent: str, tmp_path: Path) -> None:
    with pytest.raises(subprocess.CalledProcessError) as refused:
        commands_of(SCRIPT, tmp_path, percent=percent)
    assert refused.value.stderr == f"PERCENT: expected a whole number from 1 to 999, got '{percent}'\n"
    assert refused.value.returncode == 2
    assert not (tmp_path / "commands").exists()


@pytest.mark.parametrize("page", PAGES, ids=[str(path.relative_to(ROOT)) for path in PAGES])
def test_every_command_of_a_page_is_valid(page: Path) -> None:
    for line in COMMAND.findall(page.read_text(encoding="utf-8").replace("\\\n", " ")):
        parsed([word for word in shlex.split(line, comments=True) if word != "&"])
