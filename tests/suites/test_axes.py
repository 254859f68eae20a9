"""Perturbation axes and their frozen severities."""

import pytest

from suites.axes import AXES, SEVERITIES, axis_of
from suites.vocabulary import CONTROLS, Condition

SCALES = {name: axis for name, axis in AXES.items() if not axis.is_control}
every_scale = pytest.mark.parametrize("axis", SCALES.values(), ids=SCALES)
every_axis = pytest.mark.parametrize("axis", AXES.values(), ids=AXES)


def test_the_severities_are_frozen():
    """Levels that change make reports incomparable: whoever changes one gives the axis another name."""
    assert {axis.name: axis.levels for axis in AXES.values() if not axis.is_control} == {
        "camera-orbit": (5.0, 10.0, 20.0, 40.0, 75.0),
        "camera-distance": (1.05, 1.1, 1.25, 1.5, 2.0),
        "field-of-view": (2.0, 5.0, 10.0, 15.0, 20.0),
        "camera-bump": (0.5, 1.0, 2.5, 5.0, 10.0),
        "illuminance": (0.5, 1.0, 1.5, 2.0, 3.0),
        "light-direction": (15.0, 30.0, 45.0, 60.0, 80.0),
        "colour-temperature": (5500.0, 4500.0, 3500.0, 2700.0, 2000.0),
        "table": (10.0, 20.0, 35.0, 50.0, 70.0),
        "distractors": (1.0, 2.0, 4.0, 6.0, 10.0),
        "object-position": (1.0, 2.0, 4.0, 7.0, 10.0),
        "robot-start": (3.8, 7.6, 11.0, 15.0, 18.5),
        "dynamics": (1.25, 1.5, 2.0, 3.0, 5.0),
        "noise": (34.0, 28.0, 22.0, 18.4, 14.9),
        "blur": (0.3, 0.6, 1.0, 1.8, 2.7),
        "frozen-frames": (2.0, 5.0, 10.0, 20.0, 40.0),
        "action-noise": (0.5, 1.0, 2.0, 4.0, 8.0),
        "action-delay": (50.0, 100.0, 200.0, 300.0, 400.0),
        "instruction": (1.0, 2.0, 3.0, 4.0, 5.0),
    }


def test_the_quantities_that_go_with_them_are_frozen_too():
    assert {axis.name: axis.also for axis in AXES.values() if axis.also} == {
        "camera-orbit": (1.0, 2.0, 4.0, 8.0, 15.0),
        "camera-bump": (0.5, 1.0, 2.0, 3.0, 5.0),
        "robot-start": (5.0, 10.0, 16.0, 21.0, 26.0),
        "dynamics": (1.1, 1.25, 1.5, 2.0, 3.0),
    }


@every_scale
def test_levels_change_in_one_direction_and_are_farther_apart_than_what_is_tolerated(axis):
    steps = [b - a for a, b in zip(axis.levels, axis.levels[1:], strict=False)]
    assert len({step > 0 for step in steps}) == 1
    if axis.tolerance != float("inf"):
        assert min(map(abs, steps)) >= 2 * axis.tolerance


@every_axis
def test_each_axis_says_what_it_is(axis):
    assert AXES[axis.name] is axis
    assert axis.summary.endswith(".")
    assert axis.unit
    assert axis.anchors


def test_controls_have_no_scale_and_are_named_as_conditions_are():
    assert tuple(name for name, axis in AXES.items() if axis.is_control) == CONTROLS
    assert all(len(AXES[name].levels) == 1 for name in CONTROLS)
    assert [str(Condition(name, 1)) for name in CONTROLS] == list(CONTROLS)
    with pytest.raises(ValueError, match="from 1 to 1 on axis 'blind', got 2"):
        axis_of(Condition("blind", 2))


def test_codes_are_unique():
    assert len({axis.code for axis in AXES.values()}) == len(AXES)


def test_the_axis_of_a_condition_is_found_and_clean_has_none():
    assert axis_of(Condition("blur", 2)) is AXES["blur"]
    assert axis_of(Condition()) is None


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        (Condition("blurr", 1), "expected an axis out of camera-orbit, camera-distance"),
        (Condition("blur", 0), f"expected a severity from 1 to {SEVERITIES} on axis 'blur', got 0"),
        (Condition("blur", 6), "got 6"),
    ],
)
def test_a_condition_that_is_none_is_refused(condition, message):
    with pytest.raises(ValueError, match=message):
        axis_of(condition)
