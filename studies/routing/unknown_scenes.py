"""Two scenes of PyBullet that no part of a shipped model has seen, and no adapter has, for first observations."""

from __future__ import annotations

import os
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulation, TaskDescription
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.suites.episode import View

SCENES = {
    "pybullet/PandaSlide-v3": "slide the green puck to the red goal",
    "pybullet/PandaStack-v3": "stack the green cube on the blue cube at the red goals",
}
"""Task to instruction."""


def open_scene(task: str, view: View) -> Simulation:
    """Open a task of `SCENES`, whose actions and privileged state are of no use."""
    os.environ.update(worker_environment(catalog.find("pybullet")))
    import gymnasium
    import panda_gym  # noqa: F401  registers the environments

    from robogauntlet.adapters.pybullet.simulation import GOAL_COLOUR, PyBulletSimulation

    class FirstOfTwo(PyBulletSimulation):
        """A task of two cubes and two goals, of which the state has the first."""

        def reset(self, seed: int) -> None:
            super().reset(seed)
            self._task.goal = self._task.goal[:3]

    env: Any = gymnasium.make(task.partition("/")[2], disable_env_checker=True).unwrapped
    description = TaskDescription(SCENES[task], horizon=1)
    bodies = env.sim._bodies_idx
    if "target2" not in bodies:
        return PyBulletSimulation(env, description, view)
    bodies |= {"target": bodies["target1"], "object": bodies["object1"]}
    env.sim.physics_client.changeVisualShape(bodies["target2"], -1, rgbaColor=GOAL_COLOUR)
    return FirstOfTwo(env, description, view)
