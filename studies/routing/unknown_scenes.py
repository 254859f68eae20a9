"""First observations of tasks that no part of a shipped model has seen, through the adapters' own cameras.

A scene is enough for a first observation, so most are opened without what an adapter declares of a task.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulation, TaskDescription
from robogauntlet.orchestrator.environments.resolver import worker_environment
from robogauntlet.suites.episode import View

REPORTED = {
    "maniskill/PokeCube-v1": "poke the red cube with the peg",
    "maniskill/RollBall-v1": "push the ball so that it rolls to the goal",
    "maniskill/PlaceSphere-v1": "pick up the blue sphere and place it into the bin",
    "maniskill/PickCube-v1": "pick up the red cube and move it to the goal",
    "maniskill/StackPyramid-v1": "stack the three cubes to a pyramid",
    "pybullet/PandaSlide-v3": "slide the green puck to the red goal",
    "pybullet/PandaStack-v3": "stack the green cube on the blue cube at the red goals",
    "robosuite/NutAssemblyRound": "put the round nut on the round peg",
    "robosuite/PickPlaceCan": "put the can into its bin",
}
"""Task to instruction: those that are reported. Nothing is chosen on them."""
DEVELOPMENT = {
    "maniskill/LiftPegUpright-v1": "lift the peg and stand it upright",
    "maniskill/PullCubeTool-v1": "pull the cube closer with the tool",
    "robosuite/ToolHang": "put the frame into the stand and hang the tool on it",
}
"""Those on which detectors may be chosen."""
INSTRUCTIONS = REPORTED | DEVELOPMENT


def open_scene(task: str, view: View) -> Simulation:
    """Open a task of `INSTRUCTIONS`, whose actions and privileged state are of no use."""
    simulator, _, name = task.partition("/")
    os.environ.update(worker_environment(catalog.find(simulator)))
    return {"maniskill": _maniskill, "pybullet": _pybullet, "robosuite": _robosuite}[simulator](
        name, TaskDescription(INSTRUCTIONS[task], horizon=1), view
    )


def _maniskill(name: str, description: TaskDescription, view: View) -> Simulation:
    from robogauntlet.adapters.maniskill import simulation as adapter
    from robogauntlet.adapters.maniskill.tasks import Layout

    adapter.TASKS[name] = description
    adapter.LAYOUTS[name] = Layout((0.0, 0.0, 0.05))
    return adapter.open_task(name, view)


def _pybullet(name: str, description: TaskDescription, view: View) -> Simulation:
    import gymnasium
    import panda_gym  # noqa: F401  registers the environments

    from robogauntlet.adapters.pybullet.simulation import GOAL_COLOUR, PyBulletSimulation

    class FirstOfTwo(PyBulletSimulation):
        """A task of two cubes and two goals, of which the state has the first."""

        def reset(self, seed: int) -> None:
            super().reset(seed)
            self._task.goal = self._task.goal[:3]

    env: Any = gymnasium.make(name, disable_env_checker=True).unwrapped
    bodies = env.sim._bodies_idx
    if "target2" not in bodies:
        return PyBulletSimulation(env, description, view)
    bodies |= {"target": bodies["target1"], "object": bodies["object1"]}
    env.sim.physics_client.changeVisualShape(bodies["target2"], -1, rgbaColor=GOAL_COLOUR)
    return FirstOfTwo(env, description, view)


def _robosuite(name: str, description: TaskDescription, view: View) -> Simulation:
    from robogauntlet.adapters.robosuite import simulation as adapter
    from robogauntlet.adapters.robosuite.tasks import Parts

    known = adapter.TASKS.get(name)  # with what cannot vary there, such as bins in place of a table
    adapter.TASKS[name] = replace(known, instruction=description.instruction) if known else description
    adapter.PARTS.setdefault(name, Parts())
    return adapter.RobosuiteSimulation(name, view)
