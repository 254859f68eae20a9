"""JSON of others is read into values that are known."""

import math

import pytest

from robogauntlet.support.json_text import parse_json, whole_number


def test_a_whole_number_is_one_within_its_range():
    assert [whole_number(value, 1, 100) for value in (1, 100, 7.0)] == [1, 100, 7]
    for value in (None, True, "7", [7], {}, 0, -5, 101, 7.5, math.inf, -math.inf, math.nan, 10**4000):
        with pytest.raises(ValueError, match=r"^expected a whole number from 1 to 100, got .{1,60}$"):
            whole_number(value, 1, 100)


def test_a_text_that_is_nested_too_deeply_is_no_json():
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json("[" * 100_000)
