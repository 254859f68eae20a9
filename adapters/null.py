"""A simulator without physics: measures and tests the orchestrator by itself.

A point moves by the commanded translations in a unit box and must reach a goal. Task `Reach` is instant; `Slow` takes
a drawn time per episode; `Crash`, `Hang` and `Raise` misbehave on the seeds that a test names.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np

from adapters.batch import SeparateSimulations
from adapters.contract import (
    PICTURE_SIZE,
    ActionSpec,
    FloatArray,
    Image,
    Observation,
    ObservationSpec,
    Simulator,
    StepOutcome,
    TaskCard,
    UnsupportedCondition,
)
from adapters.frames import hash_state
from suites.vocabulary import CLEAN, Condition, View

MISBEHAVE_EVERY = 7
"""`Crash`, `Hang` and `Raise` misbehave on seeds divisible by this."""
CRASH_MARKER = "ROBOGAUNTLET_NULL_MARKER"
"""Names a folder: with it, an episode that has already misbehaved behaves at its next attempt."""


class NullSimulation:
    """A point that is pushed about in a box."""

    def __init__(self, task: str, view: View) -> None:
        self.task = task
        self.action_spec = ActionSpec(
            max_translation=0.05, max_rotation=0.1, control_hz=20.0, ignored=("rx", "ry", "rz", "gripper")
        )
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)
        self._view = view
        self._position = np.zeros(3)
        self._goal = np.zeros(3)
        self.pause = 0.0

    def reset(self, seed: int, condition: Condition) -> None:
        """Draw start and goal from the seed."""
        if condition.axis != CLEAN:
            raise UnsupportedCondition(f"null: condition {condition} is not supported")
        generator = np.random.default_rng([seed, 0])
        self._position = generator.uniform(-0.5, 0.5, 3)
        self._goal = generator.uniform(-0.5, 0.5, 3)
        self.pause = float(generator.lognormal(-6.0, 1.0)) if self.task == "Slow" else 0.0
        if self.task in ("Crash", "Hang", "Raise") and seed % MISBEHAVE_EVERY == 0 and self._first_time(seed):
            self._misbehave()

    def _first_time(self, seed: int) -> bool:
        folder = os.environ.get(CRASH_MARKER)
        if folder is None:
            return True
        marker = Path(folder) / f"{self.task}-{seed}"
        if marker.exists():
            return False
        marker.touch()
        return True

    def _misbehave(self) -> None:
        if self.task == "Crash":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.task == "Hang":
            time.sleep(3600)
        raise RuntimeError("the null simulator was asked to raise")

    def observe(self) -> Observation:
        """Blank images whose brightness is the distance to the goal."""
        size = self._view.image_size
        shade = min(255, int(100 * np.linalg.norm(self._goal - self._position)))
        images = {camera: np.full((size, size, 3), shade, np.uint8) for camera in self._view.cameras}
        return Observation(images, np.concatenate([self._position, np.zeros(5)]), "reach the goal")

    def step(self, action: FloatArray) -> StepOutcome:
        """Move the point, after a pause."""
        if self.pause:
            time.sleep(self.pause)
        return self.moved(action)

    def moved(self, action: FloatArray) -> StepOutcome:
        """Move the point."""
        self._position = np.clip(self._position + action[:3], -1.0, 1.0)
        return StepOutcome(reward=0.0, success=bool(np.linalg.norm(self._goal - self._position) < 0.05))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Point and goal."""
        return {
            "tcp_position": self._position.copy(),
            "tcp_quaternion": np.array([1.0, 0.0, 0.0, 0.0]),
            "finger_positions": np.zeros(2),
            "goal_position": self._goal.copy(),
        }

    def state_hash(self) -> str:
        """Hash of point and goal."""
        return hash_state({"position": self._position, "goal": self._goal})

    def picture(self) -> Image:
        """The point (dark) and the goal (green) from above."""
        picture = np.full((PICTURE_SIZE, PICTURE_SIZE, 3), 240, np.uint8)
        for place, colour in ((self._goal, (40, 160, 70)), (self._position, (40, 40, 40))):
            row, column = ((place[:2] + 1.0) / 2.0 * (PICTURE_SIZE - 1)).astype(int)
            picture[max(0, row - 5) : row + 6, max(0, column - 5) : column + 6] = colour
        return picture

    def render_device(self) -> str:
        """Nothing is drawn."""
        return "none"

    def close(self) -> None:
        """Nothing to free."""


class NullBatch(SeparateSimulations):
    """Points that move at the same time: a step takes as long as the slowest of them."""

    def step(self, actions: Mapping[int, FloatArray]) -> Mapping[int, StepOutcome]:
        """Wait once, and move these points."""
        points = {number: cast(NullSimulation, self.members[number]) for number in actions}
        if pause := max(point.pause for point in points.values()):
            time.sleep(pause)
        return {number: points[number].moved(action) for number, action in actions.items()}


def _open_batch(task: str, view: View, count: int) -> NullBatch:
    return NullBatch([NullSimulation(task, view) for _ in range(count)])


SIMULATOR = Simulator(
    name="null",
    title="null simulator (no physics)",
    tasks={task: TaskCard("reach the goal", 60) for task in ("Reach", "Slow", "Crash", "Hang", "Raise")},
    modules=(),
    distributions=(),
    open=NullSimulation,
    open_batch=_open_batch,
    renders=False,
    internal=True,
)
