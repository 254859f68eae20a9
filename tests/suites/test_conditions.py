"""Conditions as text."""

import re

import pytest
from hypothesis import given, strategies as st

from robogauntlet.orchestrator.demonstrations.variation import Variation
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.conditions import condition_patterns, read_axis, read_condition, read_severities
from robogauntlet.suites.designs import DesignEntry
from robogauntlet.suites.episode import CLEAN, CONTROLS, Condition, Episode, Perturbation, Protocol
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


def test_severities_follow_the_sign():
    assert read_condition("noise@2") == Condition("noise", 2)
    assert read_axis("noise@2,4") == ("noise", (2, 4))
    assert ConditionEntry.model_validate("noise@2,4") == ConditionEntry(axis="noise", severities=(2, 4))
    assert condition_patterns("noise@2,4") == ["noise@2", "noise@4"]
    assert condition_patterns("noise@*") == ["noise@*"]


@pytest.mark.parametrize(
    ("text", "written"), [("noise:2", "noise@2"), ("noise=2.5", "noise@2.5"), ("noise:2+table=3", "noise@2+table@3")]
)
def test_another_sign_is_refused_with_the_text_to_write(text, written):
    with pytest.raises(ValueError, match=re.escape(f"expected {written}, got '{text}'")):
        ConditionEntry.model_validate(text)
    refused = re.escape(f"{text}': expected {written}") + "$"
    with one_line_error(BadInput, refused):
        read_condition(text)
    with one_line_error(BadInput, refused):
        condition_patterns(text)
    with one_line_error(BadInput, re.escape(f"--vary {text}: expected {written}, got")):
        Variation.read([text])


@pytest.mark.parametrize("severity", [1.005, 4.996, 1.001])
def test_severities_between_hundredths_are_not_rounded(severity):
    expected = re.escape(f"expected a severity in hundredths, such as {round(severity, 2):g}, got {severity}")
    for entry in (f"noise@{severity}", {"axis": "noise", "severities": [severity]}, {"noise": severity, "table": 1}):
        with pytest.raises(ValueError, match=expected):
            ConditionEntry.model_validate(entry)
    with pytest.raises(ValueError, match=expected):
        DesignEntry.model_validate({"kind": "grid", "axes": ["noise"], "severities": [severity]})
    with one_line_error(BadInput, expected):
        read_condition(f"noise@{severity}")


def test_a_combination_has_one_spelling():
    condition = Condition("camera-orbit@2+illuminance@3.5", 1)
    assert read_condition("illuminance@3.50+camera-orbit@2.0") == condition
    assert ConditionEntry.model_validate({"illuminance": 3.5, "camera-orbit": 2}).conditions() == [condition]
    assert read_condition("noise@2.0") == Condition("noise", 2)
    assert read_condition("noise@2.5") == Condition("noise@2.5", 1)
    assert condition_patterns("illuminance@3.5+camera-orbit@2") == [str(condition)]


perturbations = st.builds(
    Perturbation, st.sampled_from(sorted(set(AXES) - set(CONTROLS))), st.integers(1, 500).map(lambda n: n / 100)
)


@given(st.lists(perturbations, max_size=6, unique_by=lambda one: one.axis), st.randoms())
def test_a_combination_is_read_back_from_its_text_in_any_order(parts, random):
    condition = Condition.of(*parts)
    assert condition.perturbations == tuple(sorted(parts))
    assert Condition.of(*random.sample(parts, len(parts))) == condition
    (again,) = ConditionEntry.model_validate(str(condition)).conditions()
    assert again == condition


@given(perturbations, st.integers(1, 5))
def test_conditions_that_differ_have_other_ids(part, severity):
    whole = Condition(part.axis, severity)
    ids = {Episode("p", "d", "null/Reach", 0, Protocol(5), one).pair_id for one in (whole, Condition.of(part))}
    assert len(ids) == 1 + (part.severity != severity)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("noise@2+noise@3", "expected each axis once, got 'noise' twice"),
        ("noise@2+tabel@3", "unknown axis 'tabel'; did you mean 'table'"),
        ("noise@2+table@6", "expected a severity from 0.01 to 5, got 6"),
        ("noise@0+table@2", "expected clean, AXIS or AXIS@SEVERITY"),
        ("noise@2+distractors@1.5", "axis 'distractors' has whole severities only, got 1.5"),
        ("blind@1+table@2", "the control 'blind' does not combine with others"),
        ("camera-bump@1+camera-orbit@2", "do not combine: both move the third-person camera"),
        ("noise@2,4+table@2", "expected clean, AXIS or AXIS@SEVERITY"),
    ],
)
def test_combinations_that_cannot_be_are_refused(text, message):
    with one_line_error(BadInput, message):
        read_condition(text)


def test_an_axis_alone_has_all_its_severities():
    assert read_axis("noise") == ("noise", (1, 2, 3, 4, 5))
    assert condition_patterns("noise") == ["noise@?"]  # one digit: no combination that begins with it
    assert [condition_patterns(name) for name in (CLEAN, *CONTROLS)] == [[name] for name in (CLEAN, *CONTROLS)]
    assert condition_patterns("*") == ["*"]


@pytest.mark.parametrize(
    "text", ["noise@", "noise@x", "noise@2,", "noise@2@4", "noise@-1", "@2", "noise@2.", "noise@²", "noise@1+table"]
)
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError, match="AXIS@SEVERITY"):
        read_severities(text)
    with one_line_error(BadInput, "such as noise@2,4"):
        read_axis(text)
    with pytest.raises(ValueError, match="AXIS@SEVERITY"):
        ConditionEntry.model_validate(text)
