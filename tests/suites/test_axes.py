"""Perturbation axes and their frozen severities."""

from itertools import combinations, pairwise

import pytest

from robogauntlet.suites.axes import AXES, EXCLUSIVE, LATENCY, SEVERITIES, axes_of, why_exclusive
from robogauntlet.suites.episode import CONTROLS, Condition, Perturbation, content_hash
from tests import ROOT

SCALES = {name: axis for name, axis in AXES.items() if name not in CONTROLS}
every_scale = pytest.mark.parametrize("axis", SCALES.values(), ids=SCALES)


def test_the_severities_are_frozen():
    """Levels that change make reports incomparable: a change of levels needs an axis of another name."""
    levels = {name: [axis.levels, axis.secondary_levels] for name, axis in AXES.items() if name not in LATENCY}
    assert content_hash(levels) == "0854d4378b87e68a"
    assert content_hash([AXES[name].levels for name in LATENCY]) == "5b80f45d21e4c78f"


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
        axes_of(Condition("blind", 2))


def test_readme_says_how_many_axes_are_comparable():
    assert sum(not axis.incomparable for axis in SCALES.values()) == 10
    assert "21 perturbation axes, ten of them [comparable" in (ROOT / "README.md").read_text()


def test_levels_are_described_with_their_unit_and_types_of_rewording_are_no_scale():
    assert [axis.name for axis in SCALES.values() if not axis.ordered] == ["instruction"]
    assert AXES["noise"].describe(4) == "18.4 dB PSNR"
    assert AXES["instruction"].describe(2) == "rewording type 2"


def test_the_axes_of_a_condition_are_found_with_their_severities_and_clean_has_none():
    assert axes_of(Condition("blur", 2)) == {AXES["blur"]: 2}
    both = Condition.of(Perturbation("table", 1.5), Perturbation("blur", 2))
    assert axes_of(both) == {AXES["blur"]: 2, AXES["table"]: 1.5}
    assert axes_of(Condition()) == {}


@every_scale
def test_levels_between_whole_severities_are_interpolated(axis):
    if axis.unchanged is None:
        with pytest.raises(ValueError, match=r"whole severities only, got 2\.5"):
            axis.value(2.5)
        return
    levels = [axis.value(hundredths / 100) for hundredths in range(1, 100 * SEVERITIES + 1)]
    assert [levels[100 * severity - 1] for severity in range(1, SEVERITIES + 1)] == list(axis.levels)
    steps = [b - a for a, b in pairwise(levels)]
    assert all(step > 0 for step in steps) or all(step < 0 for step in steps)
    assert min(levels) >= min(axis.unchanged, *axis.levels)
    assert max(levels) <= max(axis.unchanged, *axis.levels)


def test_noise_is_interpolated_in_its_deviation():
    deviations = [10 ** (-AXES["noise"].value(severity) / 20) for severity in (0.5, 1, 1.5, 2)]
    assert deviations[0] == pytest.approx(deviations[1] / 2)
    assert deviations[2] == pytest.approx((deviations[1] + deviations[3]) / 2)


def test_secondary_levels_are_interpolated_as_well():
    assert AXES["camera-orbit"].secondary_value(2.5) == pytest.approx(3.0)
    assert AXES["dynamics"].secondary_value(0.5) == pytest.approx(1.05)
    assert AXES["blur"].secondary_value(2) == 0.0


@pytest.mark.parametrize(
    ("names", "reason"),
    [
        (["noise", "blind"], "the control 'blind' does not combine with others"),
        (["camera-orbit", "camera-bump"], "'camera-bump' and 'camera-orbit' do not combine: both move"),
    ],
)
def test_axes_that_touch_the_same_do_not_combine(names, reason):
    with pytest.raises(ValueError, match=reason):
        axes_of(Condition.of(*(Perturbation(name, 1) for name in names)))


def test_all_other_pairs_combine():
    allowed = [pair for pair in combinations(SCALES, 2) if why_exclusive(pair) is None]
    assert len(allowed) == len(list(combinations(SCALES, 2))) - len(EXCLUSIVE)


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
        axes_of(condition)
