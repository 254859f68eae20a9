"""Any exception fits into one line."""

import errno
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from robogauntlet.support.errors import (
    BadInput,
    describe,
    describe_os_error,
    describe_os_error_at,
    first_line,
    last_line,
)

LINES = "first\n\n  second  \n"


class WithoutText(Exception):
    def __str__(self):
        raise RuntimeError


@given(st.text().map(ValueError) | st.builds(WithoutText) | st.text())
def test_a_line_is_never_empty_and_never_two(error):
    for line in (first_line(error), last_line(error)):
        assert line == line.strip()
        assert len(line.splitlines()) == 1


@given(st.text().map(ValueError) | st.builds(WithoutText))
def test_a_description_is_one_line_that_begins_with_the_class(error):
    assert describe(error).startswith(f"{type(error).__name__}: ")
    assert len(describe(error).splitlines()) == 1


def test_blank_lines_do_not_count():
    assert (first_line(f"\n{LINES}"), last_line(LINES)) == ("first", "second")
    assert describe(ValueError(LINES)) == "ValueError: first"


def test_without_a_message_there_is_the_class_or_no_message():
    assert (first_line(ValueError()), last_line(ValueError(" \n"))) == ("ValueError", "ValueError")
    assert last_line("\n") == "no message"
    assert describe(ValueError()) == "ValueError: no message"


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(errno.ENOSPC, "x"), "the disk is full; free some space and run again"),
        (OSError(errno.ENAMETOOLONG, "x"), "File name too long"),
        (OSError("x"), "x"),
        (ValueError("x"), "x"),
    ],
)
def test_an_error_of_the_system_says_what_to_do(error, message):
    assert describe_os_error(error) == message


def test_a_path_outside_of_the_folder_is_named_instead():
    inside, outside = (OSError(errno.ENOSPC, "full", f"{folder}/file") for folder in ("/out", "/in"))
    assert describe_os_error_at(inside, Path("/out")).startswith("/out: the disk is full")
    assert describe_os_error_at(outside, Path("/out")) == "/in/file: full"


def test_a_notebook_shows_the_message_of_bad_input_and_no_traceback():
    shown = "".join(BadInput("seeds: expected 1 or more, got 0")._render_traceback_())
    assert shown == "BadInput: seeds: expected 1 or more, got 0"
