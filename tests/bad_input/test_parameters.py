"""Every value of every verb's parameters is refused if it is empty, beyond UTF-8, too long, no number or too large."""

import math
from pathlib import Path

import pytest
from typer.main import get_command

from robogauntlet.orchestrator.cli import app
from robogauntlet.orchestrator.cli.parameters import problem

WRONG = {
    "": "expected text in UTF-8 without control characters, got ''.",
    "  ": "expected text in UTF-8 without control characters, got '  '.",
    "a\0b": r"expected text in UTF-8 without control characters, got 'a\x00b'.",
    "a\nb": r"expected text in UTF-8 without control characters, got 'a\nb'.",
    "a\udcffb": r"expected text in UTF-8 without control characters, got 'a\udcffb'.",
    "seed=" + "x" * 20_000: "expected at most 10000 characters, got 20005.",
    "x" * 300: f"expected names of at most 255 bytes and paths of 4095, got '{'x' * 40}'...",
    "/".join(["x" * 200] * 25): f"expected names of at most 255 bytes and paths of 4095, got '{'x' * 40}'...",
    Path("x" * 300): f"expected names of at most 255 bytes and paths of 4095, got '{'x' * 40}'...",
    10**20: "expected at most 1e+09, got 1e+20.",
    math.nan: "expected at most 1e+12, got nan.",
    1e300: "expected at most 1e+12, got 1e+300.",
}


def leaves(command, name=()):
    """Every verb with its name, those of groups with the group's."""
    if not hasattr(command, "commands"):
        yield name, command
        return
    for below in command.list_commands(None):
        yield from leaves(command.get_command(None, below), (*name, below))


LEAVES = list(leaves(get_command(app)))


def test_a_value_that_no_verb_can_use_is_refused_in_one_line():
    assert {value: problem(value) for value in WRONG} == WRONG
    assert {problem(value) for value in ("a b", "name=" + "x" * 300, Path("a/b"), 3, 0.5, True, None)} == {None}


@pytest.mark.parametrize(("name", "verb"), LEAVES, ids=[" ".join(name) for name, _ in LEAVES])
def test_every_verb_says_what_is_wrong_what_it_has_not_and_what_it_lacks(run_command, name, verb):
    done = run_command(*name, "--nope")
    assert done.code == 2
    assert "Error: No such option: --nope" in done.err
    if any(parameter.required for parameter in verb.params):
        done = run_command(*name)
        assert done.code == 2
        assert "Error: Missing " in done.err
    taking = next((one for one in verb.params if not getattr(one, "is_flag", False)), None)
    if taking is not None:
        wrong = [taking.opts[0], "a\udcffb"] if taking.param_type_name == "option" else ["a\udcffb"]
        done = run_command(*name, *wrong)
        assert done.code == 2
        assert "Error: " in done.err
