"""Designs: which combinations they plan."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from robogauntlet.suites.axes import AXES
from robogauntlet.suites.designs import DesignEntry, latin_hypercube, sobol_rows
from robogauntlet.suites.episode import CONTROLS, content_hash

SCALES = sorted(set(AXES) - set(CONTROLS) - {"camera-bump", "latency-continue", "latency-blend"})


def test_one_at_a_time_plans_each_axis_at_each_severity():
    design = DesignEntry(kind="one-at-a-time", axes=("noise", "table"), severities=(2, 4))
    assert list(map(str, design.conditions())) == ["noise@2", "noise@4", "table@2", "table@4"]


def test_a_grid_plans_every_combination_absence_included():
    design = DesignEntry(kind="grid", axes=("noise", "table"), severities=(2, 4.5))
    assert list(map(str, design.conditions())) == [
        *("clean", "table@2", "table@4.5"),
        *("noise@2", "noise@2+table@2", "noise@2+table@4.5"),
        *("noise@4.5", "noise@4.5+table@2", "noise@4.5+table@4.5"),
    ]


@given(st.integers(1, 6), st.integers(1, 60), st.integers(0, 99))
def test_a_latin_hypercube_has_one_point_in_each_interval_of_each_axis(axes, points, seed):
    found = np.floor(latin_hypercube(axes, points, seed) * points).astype(int)
    assert (np.sort(found, axis=0) == np.arange(points)[:, None]).all()


@given(st.sampled_from([latin_hypercube, sobol_rows]), st.integers(1, 5), st.integers(0, 5), st.integers(0, 99))
def test_twice_as_many_points_contain_the_first_half(draw, axes, power, seed):
    half, whole = draw(axes, 2**power, seed), draw(axes, 2 ** (power + 1), seed)
    assert (whole[: len(half)] == half).all()


@given(st.integers(1, 5), st.integers(0, 4), st.integers(0, 99))
def test_rows_of_a_sobol_design_differ_from_the_first_of_their_point_in_one_axis(axes, power, seed):
    rows = sobol_rows(axes, 2**power, seed).reshape(2**power, axes + 2, axes)
    for axis in range(axes):
        others = [other for other in range(axes) if other != axis]
        assert (rows[:, axis + 1, others] == rows[:, 0, others]).all()
        assert (rows[:, axis + 1, axis] == rows[:, -1, axis]).all()


@given(
    st.sampled_from(["latin-hypercube", "sobol"]),
    st.lists(st.sampled_from(SCALES), min_size=1, max_size=5, unique=True),
    st.integers(0, 4),
    st.sampled_from([1, 3, 5]),
)
def test_points_are_conditions_that_a_simulation_can_have(kind, axes, power, highest):
    design = DesignEntry(kind=kind, axes=tuple(axes), points=2**power, max_severity=highest)
    assert len(design.conditions()) == design.conditions_planned
    for condition in design.conditions():
        for part in condition.perturbations:
            assert 0 < part.severity <= highest
            AXES[part.axis].value(part.severity)


def test_kinds_and_counts_have_each_whole_severity_equally_often():
    design = DesignEntry(kind="latin-hypercube", axes=("instruction",), points=60)
    severities = [sum(part.severity for part in condition.perturbations) for condition in design.conditions()]
    assert [severities.count(severity) for severity in range(6)] == [10] * 6


@pytest.mark.parametrize(("kind", "digest"), [("latin-hypercube", "4dcf2762c2dfc6c6"), ("sobol", "bbf5d7b35fb077fe")])
def test_designs_are_frozen(kind, digest):
    """A design that changes with a release plans other episodes: stored runs are continued and read by it."""
    design = DesignEntry(kind=kind, axes=("noise", "table", "instruction"), points=32, seed=3)
    assert content_hash([str(condition) for condition in design.conditions()]) == digest


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "random"}, "Input should be 'one-at-a-time', 'grid', 'latin-hypercube' or 'sobol'"),
        ({"axes": ()}, "at least 1 item"),
        ({"axes": ("noise", "noise")}, "expected each axis once, got 'noise' twice"),
        ({"axes": ("camera-bump", "camera-orbit")}, "do not combine: both move the third-person camera"),
        ({"points": None}, "expected points of a sobol design"),
        ({"points": 0}, "greater than or equal to 1"),
        ({"points": 12}, "expected a power of two as points of a sobol design, got 12"),
        ({"points": 4096}, "expected 10000 conditions at most, got a design of 16384"),
        ({"max_severity": 6}, "less than or equal to 5"),
        ({"max_severity": 0}, "greater than 0"),
        ({"severities": (1, 2)}, "expected no 'severities' for kind sobol"),
    ],
)
def test_impossible_designs_are_refused(changes, message):
    with pytest.raises(ValidationError, match=message):
        DesignEntry.model_validate({"kind": "sobol", "axes": ("noise", "table"), "points": 8, **changes})
