"""The adapter of toysim, see `adapters.contract`. Light: the simulator is imported when a task is opened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Adjusters
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
from adapters.frames import axis_angle, hash_state
from suites.vocabulary import Condition, View

from .cameras import OWN_VIEWPOINTS, ToysimCameras

TASKS = {"Reach": TaskCard(instruction="touch the red ball", horizon=60)}
TOUCHING = 0.03
"""Distance between tool and ball at which the task is done (m)."""


class ToysimSimulation:
    """One open task, see `adapters.contract.Simulation`."""

    def __init__(self, world: Any, card: TaskCard, view: View) -> None:
        self._world, self._card, self._view = world, card, view
        self._cameras = ToysimCameras()
        self.adjusters = Adjusters(cameras=self._cameras)
        self.action_spec = ActionSpec(max_translation=0.03, max_rotation=0.1, control_hz=20.0)
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode of `seed`, and undo what was adjusted in the last."""
        if condition != Condition():
            raise UnsupportedCondition(f"toysim cannot bring about {condition}; it offers clean")
        self._cameras.now = dict(OWN_VIEWPOINTS)
        self._world.reset(seed)

    def observe(self) -> Observation:
        """Draw the cameras of the view, and read the arm."""
        images = {camera: self._draw(camera, self._view.image_size) for camera in self._view.cameras}
        world = self._world
        pose = [world.tool, axis_angle(world.turn.as_quat()), world.fingers]
        return Observation(images, np.concatenate(pose), self._card.instruction)

    def step(self, action: FloatArray) -> StepOutcome:
        """One control step. The fingers know open and close only."""
        action = np.clip(action, self.action_spec.low, self.action_spec.high)
        self._world.step(action[:3], action[3:6], closing=action[6] > 0.0)
        distance = float(np.linalg.norm(self._world.ball - self._world.tool))
        return StepOutcome(reward=-distance, success=distance < TOUCHING)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Tool, fingers, and the ball as `ball_position`."""
        world = self._world
        tool = {"tcp_position": world.tool.copy(), "tcp_quaternion": world.turn.as_quat()}
        return tool | {"finger_positions": world.fingers.copy(), "ball_position": world.ball.copy()}

    def state_hash(self) -> str:
        """All that the world remembers is in the privileged state."""
        return hash_state(self.privileged_state())

    def picture(self) -> Image:
        """The third-person view for people."""
        return self._draw("third_person", PICTURE_SIZE)

    def render_device(self) -> str:
        """What draws."""
        return "NumPy"

    def close(self) -> None:
        """Nothing to free here; a real simulator has windows, servers or contexts to close, once."""

    def _draw(self, camera: str, size: int) -> Image:
        view = self._cameras.now[camera]
        wrist = camera == "wrist"
        carrier, origin = (self._world.turn, self._world.tool) if wrist else (Rotation.identity(), np.zeros(3))
        eye, axes = origin + carrier.apply(view.position), carrier.as_matrix() @ view.rotation
        return self._world.draw(eye, axes, view.fovy, size)


def open_task(task: str, view: View) -> ToysimSimulation:
    """Open one of `TASKS`. The only place that imports the simulator."""
    from .world import World

    return ToysimSimulation(World(), TASKS[task], view)


SIMULATOR = Simulator(
    name="toysim",
    title="toysim",
    tasks=TASKS,
    modules=("robogauntlet_toysim.world",),
    distributions=("robogauntlet-toysim",),
    open=open_task,
    adjusts=frozenset({"cameras"}),
)
