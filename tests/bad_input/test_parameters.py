"""Every parameter of every verb refuses what is empty, beyond UTF-8, too long, no number or out of its range."""

import pytest
import typer
from typer.main import get_command

from robogauntlet.orchestrator.cli import app
from robogauntlet.orchestrator.cli.parameters import problem
from tests.bad_input.refusals import LONGEST_LINE

UNRANGED = {
    "change_words",
    "first_seed",
    "episodes",
    "workers",
    "image_size",
    "noise",
    "steps",
    "batch_size",
    "seed",
    "threads",
}
UNRANGED |= {"rank", "shift", "learning_rate", "fresh_trunk", "action_steps", "rounds", "keep_blocks", "bits", "alpha"}
"""Numbers whose range is checked by what they are for."""
TEXTS = {
    "": "expected a value, got an empty one.",
    "  ": "expected a value, got an empty one.",
    "a\0b": "expected text in UTF-8 without control characters, got U+0000.",
    "a\nb": "expected text in UTF-8 without control characters, got U+000A.",
    "a\x1b[31mb": "expected text in UTF-8 without control characters, got U+001B.",
    "a\udcffb": "expected text in UTF-8 without control characters, got U+DCFF.",
}
LONG = {
    "x" * 20_000: "expected at most 10000 characters, got 20000.",
    "x" * 300: f"expected names of at most 255 bytes and paths of 4095, got '{'x' * 40}...'.",
    "/".join(["x" * 200] * 25): f"expected names of at most 255 bytes and paths of 4095, got '{'x' * 40}...'.",
    "seed=" + "x" * 20_000: "expected at most 10000 characters, got 20005.",
}
WHOLE = {
    "1.5": "'1.5' is not a valid integer.",
    "٣": "'٣' is not a valid integer.",
    "9" * 20: "expected at most 1000000000 in magnitude.",
}
NUMBERS = {
    "much": "'much' is not a valid number.",
    "nan": "'nan' is not a valid number.",
    "1e300": "expected at most 1e+12 in magnitude.",
}


def leaves(command, name=()):
    """Every verb with its name, those of groups with the group's."""
    if not hasattr(command, "commands"):
        yield name, command
        return
    for below in command.list_commands(None):
        yield from leaves(command.get_command(None, below), (*name, below))


LEAVES = list(leaves(get_command(app)))
PARAMETERS = [
    (" ".join((*name, parameter.name)), typer.Context(command), parameter, parameter.process_value.args[2])
    for name, command in LEAVES
    for parameter in command.params
    if not getattr(parameter, "is_flag", False)
]
"""Name, context, parameter and type."""


def not_refused(texts):
    """The parameters that take one of these texts, or refuse it in more than a line."""
    for name, context, parameter, kind in PARAMETERS:
        for text in texts(parameter, kind):
            several = getattr(parameter, "multiple", False) or parameter.nargs != 1
            try:
                parameter.process_value(context, [text] if several else text)
            except typer.BadParameter as error:
                answer = error.message
            else:
                answer = "accepted"
            if answer == "accepted" or len(answer) > LONGEST_LINE or "\n" in answer:
                yield name, text, answer


@pytest.mark.parametrize(
    ("kind", "texts"),
    [(int, TEXTS | WHOLE), (float, TEXTS | NUMBERS), (str, TEXTS | LONG)],
    ids=["int", "float", "str"],
)
def test_a_value_of_the_wrong_kind_is_refused_in_one_line(kind, texts):
    assert {text: problem(kind, text) for text in texts} == texts


def test_every_parameter_refuses_texts_that_are_no_value():
    assert list(not_refused(lambda parameter, kind: ["", "a\udcffb", "x" * 300])) == []


def test_every_number_refuses_what_is_none_and_what_is_out_of_its_range():
    def beyond(parameter, kind):
        if kind not in (int, float):
            return []
        low, high = getattr(parameter, "min", None), getattr(parameter, "max", None)
        assert parameter.name in UNRANGED or low is not None
        below = [] if low is None else [low - 1]
        above = [] if high is None else [high + 1]
        return ["many", "1e300", *map(str, below + above)]

    assert list(not_refused(beyond)) == []


@pytest.mark.parametrize(("name", "verb"), LEAVES, ids=[" ".join(name) for name, _ in LEAVES])
def test_every_verb_says_what_it_has_not_and_what_it_lacks(run_command, name, verb):
    done = run_command(*name, "--nope")
    assert done.code == 2
    assert "Error: No such option: --nope" in done.err
    if any(parameter.required for parameter in verb.params):
        done = run_command(*name)
        assert done.code == 2
        assert "Error: Missing " in done.err
