"""Whatever is typed, a mistake is answered at once in a line that says what was expected, and changes nothing."""

import signal
import sys
from contextlib import contextmanager

import pytest
from typer.main import get_command

from robogauntlet.orchestrator.cli import VERBS, app
from tests.bad_input import folder
from tests.bad_input.case import SECRET
from tests.bad_input.cases import CASES

LONGEST_LINE = 500
"""Characters of a line of the answer."""
DEADLINE_S = 60
"""Time after which a command hangs; the slowest of these takes a second."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.typed[:60].encode("ascii", "replace").decode())
def test_bad_input_is_refused_in_one_line_and_changes_nothing(run_command, good_files, monkeypatch, case):
    place, before = good_files
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python's own cache, which is no answer to bad input
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    for name, value in case.variables.items():
        monkeypatch.setenv(name, value)
    folder.write(place, case.files)
    expected = folder.content(place) if case.files else before
    try:
        with deadline(DEADLINE_S):
            done = run_command(*case.arguments)
    finally:
        left = folder.content(place)
        if left != before:
            folder.restore(place, before, left)
    assert changed(left, expected) == []
    lines = without_usage(done.err.splitlines())
    assert done.code == case.code, done.out + done.err
    for line, says in zip(lines, case.says.splitlines(), strict=True):
        assert says in line
    assert max(map(len, lines)) <= LONGEST_LINE
    assert SECRET not in done.out + done.err


def test_the_table_is_long_and_has_every_verb_in_it():
    assert len(CASES) >= 600
    assert len({(case.typed, str(case.files), str(case.variables)) for case in CASES}) == len(CASES)
    assert [verb for verb in verbs() if not any(f"{case.typed} ".startswith(f"{verb} ") for case in CASES)] == []


@pytest.mark.parametrize(
    "typed", ["compare --accept nope", "history nope", "compare --all nope", "forget nope --history {new}"]
)
def test_a_mistake_where_no_run_is_yet_makes_no_history(run_command, tmp_path, typed):
    assert run_command(*typed.format(new=f"sqlite:///{tmp_path}/new.sqlite").split()).refusal.startswith("no ")
    assert list(tmp_path.iterdir()) == []


def verbs():
    """Every verb, those of groups with the group's name."""
    group = get_command(app)
    for name in VERBS:
        below = getattr(group.get_command(None, name), "commands", None)
        yield from [name] if below is None else [f"{name} {verb}" for verb in below]


def changed(now, before):
    """Paths that came, went or changed."""
    return sorted(path for path in {**now, **before} if now.get(path, ...) != before.get(path, ...))


def without_usage(lines):
    """The lines of an answer without those that show how the verb is used."""
    if not lines[0].startswith("Usage: "):
        return lines
    return lines[next(number for number, line in enumerate(lines) if line.startswith("Error: ")) :]


@contextmanager
def deadline(seconds):
    """Ends a block that hangs."""

    def end(*_):
        pytest.fail(f"no answer after {seconds} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
