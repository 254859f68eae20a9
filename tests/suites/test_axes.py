"""Perturbation axes and their frozen severities."""

import pytest

from robogauntlet.suites.axes import AXES, SEVERITIES, axis_of
from robogauntlet.suites.episode import CONTROLS, Condition, content_hash

SCALES = {name: axis for name, axis in AXES.items() if name not in CONTROLS}
every_scale = pytest.mark.parametrize("axis", SCALES.values(), ids=SCALES)


def test_the_severities_are_frozen():
    """Levels that change make reports incomparable: a change of levels needs an axis of another name."""
    levels = {name: [axis.levels, axis.secondary_levels] for name, axis in AXES.items()}
    assert content_hash(levels) == "169ba6970107b247"


@every_scale
def test_levels_change_in_one_direction_and_are_farther_apart_than_what_is_tolerated(axis):
    steps = [b - a for a, b in zip(axis.levels, axis.levels[1:], strict=False)]
    assert len({step > 0 for step in steps}) == 1
    if axis.tolerance != float("inf"):
        assert min(map(abs, steps)) >= 2 * axis.tolerance


def test_controls_have_no_scale_and_are_named_as_conditions_are():
    assert tuple(name for name, axis in AXES.items() if len(axis.levels) == 1) == CONTROLS
    assert [str(Condition(name, 1)) for name in CONTROLS] == list(CONTROLS)
    with pytest.raises(ValueError, match="from 1 to 1 on axis 'blind', got 2"):
        axis_of(Condition("blind", 2))


def test_levels_are_described_with_their_unit():
    assert AXES["noise"].describe(4) == "18.4 dB PSNR"
    assert AXES["instruction"].describe(2) == "rewording type 2"


def test_the_axis_of_a_condition_is_found_and_clean_has_none():
    assert axis_of(Condition("blur", 2)) is AXES["blur"]
    assert axis_of(Condition()) is None


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        (Condition("blurr", 1), "expected one of the axes camera-orbit, camera-distance"),
        (Condition("blur", 0), f"expected a severity from 1 to {SEVERITIES} on axis 'blur', got 0"),
        (Condition("blur", 6), "got 6"),
    ],
)
def test_an_unknown_condition_is_refused(condition, message):
    with pytest.raises(ValueError, match=message):
        axis_of(condition)
