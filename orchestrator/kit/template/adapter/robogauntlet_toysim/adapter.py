"""The adapter of toysim, see `robogauntlet.adapters.contract`. It imports the simulator only when a task is opened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import ActionSpec, FloatArray, Goal, Image, Simulator, StepOutcome, TaskDescription
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import View

from .cameras import OWN_VIEWPOINTS, ToysimCameras

TOUCHING = 0.03
"""Distance between tool and ball at which the task is done (m)."""
TASKS = {
    "Reach": TaskDescription(
        instruction="touch the red ball",
        horizon=60,
        goal=Goal(entry="tcp_position", to="ball_position", tolerance=TOUCHING),
    )
}


class ToysimSimulation(BaseSimulation):
    """One open task. `BaseSimulation` makes observations from `draw`."""

    def __init__(self, world: Any, description: TaskDescription, view: View) -> None:
        action_spec = ActionSpec(max_translation=0.03, max_rotation=0.1, control_hz=20.0)
        super().__init__(view, description.instruction, action_spec)
        self._world, self._cameras = world, ToysimCameras()
        self.scene_controls = SceneControls(cameras=self._cameras)

    def reset(self, seed: int) -> None:
        """Start the episode of `seed` with the own viewpoints."""
        self._cameras.now = dict(OWN_VIEWPOINTS)
        self._world.reset(seed)

    def step(self, action: FloatArray) -> StepOutcome:
        """Execute one control step. The fingers only open and close."""
        action = np.clip(action, self.action_spec.low, self.action_spec.high)
        self._world.step(action[:3], action[3:6], closing=action[6] > 0.0)
        distance = float(np.linalg.norm(self._world.ball - self._world.tool))
        return StepOutcome(reward=-distance, success=distance < TOUCHING)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return tool, fingers, and the ball as `ball_position`."""
        world = self._world
        tool = {"tcp_position": world.tool.copy(), "tcp_quaternion": world.turn.as_quat()}
        return tool | {"finger_positions": world.fingers.copy(), "ball_position": world.ball.copy()}

    def state_hash(self) -> str:
        """Hash the privileged state, which holds the whole state of this world."""
        return hash_state(self.privileged_state())

    def draw(self, camera: str, size: int) -> Image:
        """Render the present world, (size, size, 3)."""
        view = self._cameras.now[camera]
        wrist = camera == "wrist"
        carrier, origin = (self._world.turn, self._world.tool) if wrist else (Rotation.identity(), np.zeros(3))
        eye, axes = origin + carrier.apply(view.position), carrier.as_matrix() @ view.rotation
        return self._world.draw(eye, axes, view.fovy, size)

    def render_device(self) -> str:
        """Name the renderer."""
        return "NumPy"

    def close(self) -> None:
        """Free nothing; a real simulator closes its windows, servers or contexts here, once."""


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
