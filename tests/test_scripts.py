"""The commands of the scripts that take hours are valid."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pytest
import typer

from robogauntlet.orchestrator.cli import app
from tests import ROOT

SCRIPTS = ROOT / "scripts"
# Replaces the command line: writes the arguments of each call into a line of a file.
RECORDER = """#!/usr/bin/env bash
line=$(printf '%s\\t' "$@")
echo "$line" >>"${0%/*}/commands"
"""


def commands_of(script: str, folder: Path, *words: str, percent: str | None = None) -> list[list[str]]:
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
    command = ["bash", str(SCRIPTS / script), str(folder / "out"), *words]
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


@pytest.mark.parametrize(
    ("script", "verbs"),
    [
        ("zoo.sh", 24),
        ("training_controls.sh", 325),
        ("robust_experts.sh", 31),
        ("arms.sh", 24),
        ("two_arms.sh", 10),
        ("so101.sh", 5),
        ("meta_world.sh", 40),
        ("libero.sh", 55),
        ("stacking.sh", 13),
    ],
)
def test_every_command_of_the_long_scripts_is_valid(script: str, verbs: int, tmp_path: Path) -> None:
    commands = commands_of(script, tmp_path)
    for command in commands:
        parsed(command)
    assert len(commands) == verbs


def test_plain_experts_and_those_of_varied_scenes_have_an_equal_budget(tmp_path: Path) -> None:
    commands = [parsed(command) for command in commands_of("robust_experts.sh", tmp_path)]
    trained, recorded = ([one for one in commands if name in one] for name in ("steps", "episodes"))
    same = ("steps", "learning_rate", "shift", "adapt_convolutions", "action_steps")
    budgets: dict[str, dict[str, list[object]]] = {"plain/experts": {}, "equal-budget": {}}
    words: dict[str, set[object]] = {"plain/experts": set(), "equal-budget": set()}
    for (kind, found), command in product(budgets.items(), trained):
        out = Path(str(command["out_folder"]))
        if out.parent == tmp_path / "out" / kind:
            found[out.name] = [command[name] for name in same]
            words[kind].add(command["change_words"])
    assert len(budgets["plain/experts"]) == 3
    assert budgets["plain/experts"] == budgets["equal-budget"]
    assert words == {"plain/experts": {0.0}, "equal-budget": {0.3}}
    episodes = {
        kind: {
            (Path(str(one["out_folder"])).name, str(one["names"])): one["episodes"]
            for one in recorded
            if kind in Path(str(one["out_folder"])).parts
        }
        for kind in ("plain", "varied")
    }
    assert len(episodes["plain"]) == 4
    assert episodes["plain"].items() <= episodes["varied"].items()


def test_percent_uses_that_share_and_at_least_three_demonstrations(tmp_path: Path) -> None:
    options = [parsed(command) for command in commands_of("zoo.sh", tmp_path, percent="1")]
    assert {values["episodes"] for values in options if "episodes" in values} == {3, 4, 5, 6, 20}
    assert {values["steps"] for values in options if "steps" in values} == {13, 15, 18, 32, 40, 50, 90, 200}


@pytest.mark.parametrize(
    "script", ["zoo.sh", "training_controls.sh", "robust_experts.sh", "meta_world.sh", "libero.sh"]
)
@pytest.mark.parametrize("percent", ["0", "-1", "half", "1000", "1.5"])
def test_a_share_that_is_no_whole_percent_is_refused_first(script: str, percent: str, tmp_path: Path) -> None:
    with pytest.raises(subprocess.CalledProcessError) as refused:
        commands_of(script, tmp_path, percent=percent)
    assert refused.value.stderr == f"PERCENT: expected a whole number from 1 to 999, got '{percent}'\n"
    assert refused.value.returncode == 2
    assert not (tmp_path / "commands").exists()


def test_a_suite_that_libero_lacks_is_refused_first(tmp_path: Path) -> None:
    with pytest.raises(subprocess.CalledProcessError) as refused:
        commands_of("libero.sh", tmp_path, "goal", "gaol")
    assert refused.value.stderr == "SUITE: expected spatial, object, goal or 10, got 'gaol'\n"
    assert refused.value.returncode == 2
    assert not (tmp_path / "commands").exists()
