"""Conditions as text."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robogauntlet.suites.axes import AXES
from robogauntlet.suites.conditions import condition_patterns, read_axis, read_condition, read_severities
from robogauntlet.suites.episode import CLEAN, CONTROLS, Condition
from robogauntlet.suites.schema import ConditionEntry
from robogauntlet.support.errors import BadInput
from tests.errors import one_line_error

SHOWN = [Condition(axis, severity) for axis, known in AXES.items() for severity in range(1, len(known.levels) + 1)]


@given(st.sampled_from([Condition(), *SHOWN]))
def test_what_tables_show_can_be_given(condition):
    assert read_condition(str(condition)) == condition
    (again,) = ConditionEntry.model_validate(str(condition)).conditions()
    assert again == condition
    assert condition_patterns(str(condition)) == [str(condition)]


@pytest.mark.parametrize("sign", "@:")
def test_both_signs_say_the_same(sign):
    assert read_condition(f"noise{sign}2") == Condition("noise", 2)
    assert read_axis(f"noise{sign}2,4") == ("noise", (2, 4))
    assert ConditionEntry.model_validate(f"noise{sign}2,4") == ConditionEntry(axis="noise", severities=(2, 4))
    assert condition_patterns(f"noise{sign}2,4") == ["noise@2", "noise@4"]
    assert condition_patterns(f"noise{sign}*") == ["noise@*"]


def test_an_axis_alone_has_all_its_severities():
    assert read_axis("noise") == ("noise", (1, 2, 3, 4, 5))
    assert condition_patterns("noise") == ["noise@*"]
    assert [condition_patterns(name) for name in (CLEAN, *CONTROLS)] == [[name] for name in (CLEAN, *CONTROLS)]
    assert condition_patterns("*") == ["*"]


@pytest.mark.parametrize(
    "text", ["noise@", "noise@x", "noise@2,", "noise@2@4", "noise:-1", "@2", "noise@2.5", "noise@²"]
)
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError, match="AXIS@SEVERITY"):
        read_severities(text)
    with one_line_error(BadInput, "such as noise@2,4"):
        read_axis(text)
    with pytest.raises(ValueError, match="AXIS@SEVERITY"):
        ConditionEntry.model_validate(text)
