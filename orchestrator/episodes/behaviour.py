"""Measures how the robot moves in an episode: the columns `BEHAVIOUR` of its record."""

from __future__ import annotations

from typing import Any

import numpy as np

from robogauntlet.adapters.contract import AdapterError, FloatArray, Goal, Motion, Simulation
from robogauntlet.adapters.goals import goal_distance, goal_mistakes
from robogauntlet.adapters.motion import motion_reader
from robogauntlet.orchestrator.episodes.failure_kind import Course, kind_of_failure
from robogauntlet.results.record import Status
from robogauntlet.suites.episode import SUCCESS_HOLD

TOOL = "tcp_position"
OPENED = 0.01
"""Least change of the distance between the fingers that is an opening or a closing (m)."""
AT_LIMIT = 0.01
"""Distance from its limit at which a joint is at it (rad)."""
WORKSPACE_MARGIN = 0.2
"""Of the workspace around the box of the start positions of tool, object and goal (m)."""
HIGHEST_FREQUENCY = 10.0
"""Of the tool's speed, for smoothness (Hz)."""
SMALLEST_SHARE = 0.05
"""Of the largest amplitude in the speed's spectrum, below which it is noise."""


AT_REST = 2
"""Control steps after which objects that are reset above the table have come to it, and their start is taken."""


class BehaviourMeter:
    """Takes the motion after each control step; changes nothing."""

    def __init__(self, simulation: Simulation, goal: Goal | None) -> None:
        """Take the clean simulation, before its reset, and the goal of its task."""
        self._hz, self._goal = simulation.action_spec.control_hz, goal
        names = dict.fromkeys((goal.entry, goal.handle or goal.entry, goal.to or goal.entry)) if goal else ()
        self._names = tuple(names)
        self._motion = None if simulation.action_spec.numbers else motion_reader(simulation)
        """None where nothing shows a tool."""
        self._samples = 0
        self._motions: list[Motion] = []

    def sample(self) -> None:
        """Take the present motion: after the reset, and after each control step.

        Raises:
            AdapterError: The task's goal does not fit the privileged state.
        """
        self._samples += 1
        if self._motion is None:
            return
        motion = self._motion(self._names)
        if self._goal is not None and not self._motions:
            entries = dict(zip(self._names, motion.entries, strict=True))
            for field, expected, found in goal_mistakes(self._goal, entries):
                raise AdapterError(f"the task's goal: {field}: expected {expected}, found {found}")
        self._motions.append(motion)

    def columns(self, status: Status, success_hold: int = SUCCESS_HOLD) -> dict[str, Any]:
        """The columns of an episode that ended like this, with the samples so far.

        A success is one if the predicate held for `success_hold` steps.

        Raises:
            AdapterError: A number of the motion is not finite.
        """
        motions, hz = self._motions, self._hz
        succeeded = status is Status.SUCCESS
        ended = {"time_to_success": round((self._samples - success_hold) / hz, 3) if succeeded else None}
        if self._motion is None:
            return ended
        tool = np.array([motion.tool for motion in motions])
        opening = np.array([motion.opening for motion in motions])
        lengths = np.linalg.norm(np.diff(tool, axis=0), axis=1)
        forces = [motion.contact_force for motion in motions[1:] if motion.contact_force is not None]
        margins = [motion.joint_margin for motion in motions[1:] if motion.joint_margin is not None]
        measured = [tool, opening, np.array(forces), *map(self._entry, self._names)]
        if not all(np.isfinite(values).all() for values in measured):
            raise AdapterError("expected finite numbers in the simulation's motion")
        columns: dict[str, Any] = {
            **ended,
            "path_length": round(float(lengths.sum()), 4),
            "smoothness": smoothness(lengths * hz, hz),
            "gripper_openings": openings(opening.tolist()),
            "contact_steps": sum(force > 0.0 for force in forces) if forces else None,
            "contact_force": round(max(forces), 1) if forces else None,
            "joint_limit_steps": sum(margin < AT_LIMIT for margin in margins) if margins else None,
        }
        if self._goal is not None:
            course = self._course(self._goal, tool, opening, max(forces, default=0.0))
            columns["workspace_steps"] = self._outside(tool)
            columns["progress"] = progress(course.remaining[self._start(self._goal) :], course.tolerance)
            columns["failure"] = None if succeeded else str(kind_of_failure(course))
        return columns

    def _entry(self, name: str) -> FloatArray:
        """Values of an entry, (steps + 1, n)."""
        place = self._names.index(name)
        return np.array([motion.entries[place] for motion in self._motions])

    def _start(self, goal: Goal) -> int:
        """Number of the sample with the start of what has to change."""
        return 0 if goal.entry == TOOL else min(AT_REST, len(self._motions) - 1)

    def _course(self, goal: Goal, tool: FloatArray, opening: FloatArray, largest_force: float) -> Course:
        value, handle = self._entry(goal.entry), self._entry(goal.handle or goal.entry)
        start = self._start(goal)
        # Where the tool itself is the handle, its height does not tell whether the object falls.
        height = value if goal.handle == TOOL and value.shape[1] == 3 else handle
        return Course(
            remaining=goal_distance(goal, value, self._entry(goal.to) if goal.to else value[start]),
            reach=np.linalg.norm(handle - tool, axis=1),
            moved=np.linalg.norm(value - value[start], axis=1),
            lifted=height[:, 2] - height[start, 2],
            opening=opening,
            largest_force=largest_force,
            tolerance=goal.tolerance,
            tool_only=goal.entry == TOOL,
            grasped=goal.grasped,
            stays_held=not goal.to,
        )

    def _outside(self, tool: FloatArray) -> int:
        """Steps at whose end the tool is outside the workspace."""
        starts = np.array([tool[0], *(entry for entry in self._motions[0].entries if len(entry) == 3)])
        low, high = starts.min(axis=0) - WORKSPACE_MARGIN, starts.max(axis=0) + WORKSPACE_MARGIN
        return int(((tool[1:] < low) | (tool[1:] > high)).any(axis=1).sum())


def progress(remaining: FloatArray, tolerance: float) -> float:
    """Share of the distance from the goal that was covered at the end, from -1 (as far again) to 1 (within tolerance).

    `remaining` is that distance from the start on, shape (n,).
    """
    first, last = (max(0.0, float(remaining[i]) - tolerance) for i in (0, -1))
    if first < 1e-6:
        return 1.0 if last < 1e-6 else -1.0
    return round(max(-1.0, 1.0 - last / first), 3) + 0.0


def openings(widths: list[float]) -> int:
    """Times that fingers opened by more than `OPENED`, of the distances between them (m)."""
    count, opened, extreme = 0, False, widths[0]
    for width in widths:
        if opened:
            extreme = max(extreme, width)
            if width < extreme - OPENED:
                opened, extreme = False, width
        else:
            extreme = min(extreme, width)
            if width > extreme + OPENED:
                count, opened, extreme = count + 1, True, width
    return count


def smoothness(speeds: FloatArray, hz: float) -> float | None:
    """Spectral arc length of a profile of speeds, shape (n,); None if there is no motion.

    After Balasubramanian, Melendez-Calderon, Roby-Brami and Burdet (2015), "On the analysis of movement smoothness".
    """
    if len(speeds) < 2 or speeds.max() <= 0.0:
        return None
    size = 2 ** ((len(speeds) - 1).bit_length() + 4)
    amplitudes, frequencies = np.abs(np.fft.rfft(speeds, size)), np.fft.rfftfreq(size, 1.0 / hz)
    amplitudes = amplitudes[frequencies <= HIGHEST_FREQUENCY] / amplitudes.max()
    amplitudes = amplitudes[: np.flatnonzero(amplitudes >= SMALLEST_SHARE)[-1] + 1]
    if len(amplitudes) < 2:
        return None
    return round(-float(np.hypot(np.diff(amplitudes), 1.0 / (len(amplitudes) - 1)).sum()), 3)
