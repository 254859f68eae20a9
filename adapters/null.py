"""A simulator without physics, to measure and test the orchestrator.

A point moves by the commanded translations in a unit box and must reach a goal. Task `Reach` is instant; `Slow` takes
a random time per episode; `Crash`, `Hang` and `Raise` misbehave on some seeds.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from robogauntlet.adapters.contract import (
    PENDING,
    PICTURE_SIZE,
    ActionSpec,
    FloatArray,
    Goal,
    Image,
    Observation,
    ObservationSpec,
    Simulator,
    StepOutcome,
    TaskDescription,
)
from robogauntlet.adapters.frames import hash_state
from robogauntlet.suites.episode import View

MISBEHAVE_EVERY = 7
"""`Crash`, `Hang` and `Raise` misbehave on seeds divisible by this."""
GOAL = Goal("tcp_position", "goal_position", tolerance=0.05)
CRASH_MARKER = "ROBOGAUNTLET_NULL_MARKER"
"""Environment variable with a folder: if set, an episode misbehaves at its first attempt only."""


class NullSimulation:
    """A point that moves in a box."""

    def __init__(self, task: str, view: View) -> None:
        self.task = task
        self.action_spec = ActionSpec(0.05, 0.1, control_hz=20.0, ignored=("rx", "ry", "rz", "gripper"))
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)
        self._view = view
        self._position = np.zeros(3)
        self._goal = np.zeros(3)
        self._pause = 0.0

    def reset(self, seed: int) -> None:
        """Draw start and goal from the seed."""
        generator = np.random.default_rng([seed, 0])
        self._position = generator.uniform(-0.5, 0.5, 3)
        self._goal = generator.uniform(-0.5, 0.5, 3)
        self._pause = float(generator.lognormal(-6.0, 1.0)) if self.task == "Slow" else 0.0
        if self.task in ("Crash", "Hang", "Raise") and seed % MISBEHAVE_EVERY == 0 and self._is_first_attempt(seed):
            self._misbehave()

    def _is_first_attempt(self, seed: int) -> bool:
        folder = os.environ.get(CRASH_MARKER)
        if folder is None:
            return True
        marker = Path(folder) / f"{self.task}-{seed}"
        is_first = not marker.exists()
        marker.touch()
        return is_first

    def _misbehave(self) -> None:
        if self.task == "Crash":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.task == "Hang":
            time.sleep(3600)
        raise RuntimeError("the null simulator was asked to raise")

    def observe(self) -> Observation:
        """Return uniform images whose brightness is the distance to the goal."""
        size = self._view.image_size
        shade = min(255, int(100 * np.linalg.norm(self._goal - self._position)))
        images = {camera: np.full((size, size, 3), shade, np.uint8) for camera in self._view.cameras}
        return Observation(images, np.concatenate([self._position, np.zeros(5)]), "reach the goal")

    def step(self, action: FloatArray) -> StepOutcome:
        """Move the point, after a pause."""
        if self._pause:
            time.sleep(self._pause)
        self._position = np.clip(self._position + action[:3], -1.0, 1.0)
        return StepOutcome(reward=0.0, success=bool(np.linalg.norm(self._goal - self._position) < 0.05))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return point and goal."""
        return {
            "tcp_position": self._position.copy(),
            "tcp_quaternion": np.array([1.0, 0.0, 0.0, 0.0]),
            "finger_positions": np.zeros(2),
            "goal_position": self._goal.copy(),
        }

    def state_hash(self) -> str:
        """Hash point and goal."""
        return hash_state({"position": self._position, "goal": self._goal})

    def picture(self) -> Image:
        """Draw the point (dark) and the goal (green) from above."""
        picture = np.full((PICTURE_SIZE, PICTURE_SIZE, 3), 240, np.uint8)
        for place, colour in ((self._goal, (40, 160, 70)), (self._position, (40, 40, 40))):
            row, column = ((place[:2] + 1.0) / 2.0 * (PICTURE_SIZE - 1)).astype(int)
            picture[max(0, row - 5) : row + 6, max(0, column - 5) : column + 6] = colour
        return picture

    def render_device(self) -> str:
        """Return `none`."""
        return "none"

    def close(self) -> None:
        """Do nothing."""


class NullBatch:
    """Several worlds, see `contract.BatchSimulation`."""

    def __init__(self, task: str, view: View, count: int) -> None:
        self.worlds = tuple(_World(task, view) for _ in range(count))

    def advance(self) -> Sequence[StepOutcome | None]:
        """Move the points that have an action."""
        return [world.advance() for world in self.worlds]


class _World(NullSimulation):
    noted: FloatArray | None = None

    def step(self, action: FloatArray) -> StepOutcome:
        """Note the action."""
        self.noted = action.copy()
        return PENDING

    def advance(self) -> StepOutcome | None:
        """Move the point if there is an action."""
        action, self.noted = self.noted, None
        return None if action is None else super().step(action)


SIMULATOR = Simulator(
    name="null",
    title="null simulator (no physics)",
    tasks=dict.fromkeys(("Reach", "Slow", "Crash", "Hang", "Raise"), TaskDescription("reach the goal", 60, goal=GOAL)),
    modules=(),
    distributions=(),
    open=NullSimulation,
    renders=False,
    internal=True,
)
