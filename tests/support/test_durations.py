"""Durations as text."""

import pytest

from robogauntlet.support.durations import format_duration


@pytest.mark.parametrize(
    ("seconds", "shown", "brief"),
    [
        (-1, "0 s", "0 s"),
        (45.4, "45 s", "45 s"),
        (59.9, "1 min 0 s", "1 min"),
        (200, "3 min 20 s", "3 min"),
        (7500, "2 h 5 min", "2 h 5 min"),
        (172_800, "48 h 0 min", "2 days"),
    ],
)
def test_a_duration_has_a_fitting_unit(seconds, shown, brief):
    assert (format_duration(seconds), format_duration(seconds, brief=True)) == (shown, brief)
