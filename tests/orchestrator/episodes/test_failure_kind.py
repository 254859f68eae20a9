"""The rules that tell kinds of failures apart."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from robogauntlet.orchestrator.episodes.failure_kind import UNSAFE_FORCE, Course, held, kind_of_failure
from robogauntlet.results.record import FailureKind

STEPS = 40


def series(*points):
    """Values at the start and after each step, straight between (step, value)."""
    at, values = zip(*points, strict=True)
    return np.interp(np.arange(STEPS + 1), at, values)


OPEN, STILL = series((0, 0.08)), series((0, 0.0))
CLOSING = series((0, 0.08), (15, 0.08), (17, 0.04))
"""Fingers that close around an object 4 cm wide."""
FAR = series((0, 0.3))
ARRIVING = series((0, 0.3), (15, 0.01))
PUSH = Course(FAR, FAR, STILL, STILL, OPEN, largest_force=0.0, tolerance=0.05)
PICK = replace(PUSH, grasped=True)
HOLDING = replace(
    PICK,
    reach=ARRIVING,
    opening=CLOSING,
    moved=series((17, 0.0), (25, 0.2)),
    lifted=series((17, 0.0), (25, 0.1)),
    remaining=series((17, 0.3), (25, 0.2)),
)
"""Grasped, carried a part of the way, and held there until the end."""


def test_a_tool_that_never_came_near_has_not_reached_the_object():
    assert {kind_of_failure(PUSH), kind_of_failure(PICK)} == {FailureKind.NOT_REACHED}


def test_an_object_that_was_reached_and_lies_still_was_not_moved_or_not_grasped():
    assert kind_of_failure(replace(PUSH, reach=ARRIVING)) == FailureKind.NOT_MOVED
    assert kind_of_failure(replace(PICK, reach=ARRIVING)) == FailureKind.NOT_GRASPED


def test_an_object_that_was_pushed_around_by_open_fingers_was_not_grasped():
    assert kind_of_failure(replace(PICK, reach=ARRIVING, moved=series((10, 0.0), (30, 0.2)))) == FailureKind.NOT_GRASPED


def test_closed_fingers_above_an_object_do_not_hold_it():
    above = replace(HOLDING, opening=series((0, 0.08), (15, 0.08), (17, 0.0)), lifted=STILL)
    assert not held(above).any()


def test_a_bowl_that_is_lifted_by_its_rim_is_held():
    bowl = replace(HOLDING, reach=series((0, 0.3), (15, 0.08)), opening=series((0, 0.08), (15, 0.08), (17, 0.003)))
    assert held(bowl)[-1]


def test_an_object_that_falls_far_from_the_goal_was_dropped():
    falls = replace(
        HOLDING,
        opening=series((0, 0.08), (15, 0.08), (17, 0.04), (30, 0.04), (31, 0.08)),
        lifted=series((17, 0.0), (25, 0.1), (30, 0.1), (32, 0.0)),
        reach=series((0, 0.3), (15, 0.01), (30, 0.01), (32, 0.12)),
    )
    assert kind_of_failure(falls) == FailureKind.DROPPED


@pytest.mark.parametrize(("lifted", "remaining"), [(0.0, 0.2), (0.1, 0.06)])
def test_an_object_that_is_put_down_elsewhere_or_falls_beside_the_goal_was_misplaced(lifted, remaining):
    released = replace(
        HOLDING,
        opening=series((0, 0.08), (15, 0.08), (17, 0.04), (30, 0.04), (31, 0.08)),
        lifted=series((17, 0.0), (25, 0.1), (29, lifted), (32, 0.0)),
        remaining=series((17, 0.3), (25, remaining)),
        reach=series((0, 0.3), (15, 0.01), (30, 0.01), (32, 0.12)),
    )
    assert kind_of_failure(released) == FailureKind.MISPLACED
    assert kind_of_failure(replace(released, stays_held=True)) == FailureKind.DROPPED


def test_an_object_that_is_held_at_the_end_was_misplaced_or_still_on_its_way():
    assert kind_of_failure(HOLDING) == FailureKind.MISPLACED
    assert kind_of_failure(replace(HOLDING, remaining=series((17, 0.3), (40, 0.1)))) == FailureKind.TIMED_OUT


def test_an_object_that_was_moved_elsewhere_was_misplaced_or_is_still_on_its_way():
    pushed = replace(PUSH, reach=ARRIVING, moved=series((15, 0.0), (30, 0.2)))
    assert kind_of_failure(pushed) == FailureKind.MISPLACED
    assert kind_of_failure(replace(pushed, remaining=series((15, 0.3), (40, 0.1)))) == FailureKind.TIMED_OUT


@pytest.mark.parametrize("course", [PUSH, PICK])
def test_a_tool_that_still_approaches_has_timed_out(course):
    assert kind_of_failure(replace(course, reach=series((0, 0.3), (40, 0.15)))) == FailureKind.TIMED_OUT


def test_a_goal_of_the_tool_is_not_reached_left_again_or_still_approached():
    tool = replace(PUSH, reach=STILL, tool_only=True)
    assert kind_of_failure(tool) == FailureKind.NOT_REACHED
    assert kind_of_failure(replace(tool, remaining=series((0, 0.3), (10, 0.01), (20, 0.2)))) == FailureKind.MISPLACED
    assert kind_of_failure(replace(tool, remaining=series((0, 0.3), (40, 0.1)))) == FailureKind.TIMED_OUT


def test_a_failure_with_a_large_force_is_unsafe_whatever_else_happened():
    for course in (PUSH, PICK, HOLDING):
        assert kind_of_failure(replace(course, largest_force=UNSAFE_FORCE + 1.0)) == FailureKind.UNSAFE


@given(
    st.lists(st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5), min_size=2, max_size=30),
    st.floats(0.0, 300.0),
    st.booleans(),
    st.booleans(),
    st.booleans(),
)
def test_every_course_has_a_kind(rows, force, tool_only, grasped, stays_held):
    columns = np.array(rows).T
    assert kind_of_failure(Course(*columns, force, 0.05, tool_only, grasped, stays_held)) in FailureKind
