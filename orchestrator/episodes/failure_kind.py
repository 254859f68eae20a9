"""Tells kinds of failures apart, by distances that were measured after each control step. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.results.record import FailureKind

UNSAFE_FORCE = 140.0
"""Force between the robot and what is not part of the task beyond which a failure is unsafe: what ISO/TS 15066 permits
against a hand (N)."""
REACHED = 0.06
"""Distance of the tool from the handle at which it has reached it (m)."""
HELD, CARRIED = 0.04, 0.1
"""Largest distance between tool and handle of an object between the fingers, and of one that is lifted, such as a bowl
by its rim (m)."""
MOVED = 0.01
"""Change of the entry from which an object has moved, or is lifted (m, rad)."""
CLOSED_BY, HELD_APART = 0.01, 0.005
"""How much less than before fingers that hold something are open, and at least (m)."""
NEAR = 0.03
"""Distance beyond the goal's tolerance within which an object that is let go of was put there (m, rad)."""
FALL = 0.02
"""Height from which an object that is let go of elsewhere is dropped rather than put down (m)."""
LATE, APPROACH, AT_CLOSEST = 0.25, 0.05, 0.005
"""Last part of the episode; share of the first distance by which something still approaches in it; largest distance
from the closest that it came (m, rad)."""


@dataclass(frozen=True)
class Course:
    """Distances at the start and after each control step, arrays of shape (steps + 1,); there is a step at least."""

    remaining: FloatArray
    """From the goal (m, rad)."""
    reach: FloatArray
    """From the tool to the handle (m)."""
    moved: FloatArray
    """Change of the goal's entry from the start (m, rad)."""
    lifted: FloatArray
    """Height of the handle above its start, or of the object if the tool itself is the handle (m)."""
    opening: FloatArray
    """Between the fingers (m)."""
    largest_force: float
    """Between the robot and what is not part of the task (N)."""
    tolerance: float
    """Of the goal (m, rad)."""
    tool_only: bool = False
    """The goal is a place of the tool."""
    grasped: bool = False
    """The gripper has to hold the object."""
    stays_held: bool = False
    """It has to hold it until the end."""


def kind_of_failure(course: Course) -> FailureKind:
    """Return the kind of the failure in an episode that did not succeed."""
    if course.largest_force > UNSAFE_FORCE:
        return FailureKind.UNSAFE
    if course.tool_only:
        return _without_object(course)
    return _of_grasp(course) if course.grasped else _of_motion(course)


def held(course: Course) -> NDArray[np.bool_]:
    """Whether the gripper holds the object, at the start and after each step."""
    closed = course.opening < np.maximum.accumulate(course.opening) - CLOSED_BY
    between = (course.reach <= HELD) & (course.opening >= HELD_APART)
    carried = (course.reach <= CARRIED) & (course.lifted > MOVED)
    holds: NDArray[np.bool_] = closed & (course.moved > MOVED) & (between | carried)
    return holds


def _without_object(course: Course) -> FailureKind:
    if _approaching(course.remaining):
        return FailureKind.TIMED_OUT
    arrived = course.remaining.min() <= course.tolerance
    return FailureKind.MISPLACED if arrived else FailureKind.NOT_REACHED


def _of_motion(course: Course) -> FailureKind:
    if course.moved.max() <= MOVED:
        return _before_touch(course, FailureKind.NOT_MOVED)
    return FailureKind.TIMED_OUT if _approaching(course.remaining) else FailureKind.MISPLACED


def _of_grasp(course: Course) -> FailureKind:
    times = np.flatnonzero(held(course))
    if not len(times):
        return _before_touch(course, FailureKind.NOT_GRASPED)
    last = times[-1]
    if last == len(course.reach) - 1:
        return FailureKind.TIMED_OUT if _approaching(course.remaining) else FailureKind.MISPLACED
    near = course.remaining[last] <= course.tolerance + NEAR
    put_down = near or course.lifted[last] - course.lifted[-1] < FALL
    return FailureKind.MISPLACED if put_down and not course.stays_held else FailureKind.DROPPED


def _before_touch(course: Course, reached: FailureKind) -> FailureKind:
    if _approaching(course.reach):
        return FailureKind.TIMED_OUT
    return reached if course.reach.min() <= REACHED else FailureKind.NOT_REACHED


def _approaching(distance: FloatArray) -> bool:
    """Whether a distance shrank until the end."""
    earlier = distance[-1 - max(1, int(LATE * (len(distance) - 1)))]
    closest = distance[-1] <= distance.min() + AT_CLOSEST
    return bool(closest and earlier - distance[-1] > APPROACH * distance[0])
