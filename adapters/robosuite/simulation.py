"""robosuite (MuJoCo): the Panda at its table with Lift, Stack and Door, under the benchmark's default controller.

What is particular here:

- The controller is OSC_POSE with delta input in the base frame: a critically damped spring between the tool and a goal
  that is set anew, from the pose achieved, in each control step. In steady motion it covers sqrt(kp) / 2 * dt = 31 % of
  the offset it is given. The adapter gives it that much more, so that the tool centre point moves by the action;
  `ActionSpec` states what remains of the controller's range. A lone rotation drags the tool centre point along.
- The gripper looks only at the sign of its command: it moves by a fixed amount, and stays where it is at exactly 0.
- The size of Lift's cube is drawn once while the model is built, always from `BUILD_SEED`; robosuite's `hard_reset`
  would draw it anew in each episode, at a second or more per reset.
- `fast` draws no shadows, no reflections and no multisampling. It takes a third to a quarter of the time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from adapters.adjusting import Adjusters
from adapters.contract import (
    ActionSpec,
    FloatArray,
    Simulator,
    SimulatorUnavailable,
    StepOutcome,
    TaskCard,
    UnsupportedCondition,
)
from adapters.mujoco_parts.arm import MujocoArm
from adapters.mujoco_parts.bodies import MujocoBodies
from adapters.mujoco_parts.cameras import MujocoCameras
from adapters.mujoco_parts.frame import BaseFrame
from adapters.mujoco_parts.lights import MujocoLights
from adapters.mujoco_parts.simulation import MujocoSimulation, import_with_mujoco, reached_share
from adapters.mujoco_parts.stage import MujocoStage
from adapters.robosuite.objects import RobosuiteObjects
from suites.vocabulary import CLEAN, Condition, View

CONTROL_HZ = 20.0
BUILD_SEED = 0
"""Seeds what robosuite draws while it builds a model."""

TASKS = {
    "Lift": TaskCard("lift the red cube off the table", horizon=80),
    "Stack": TaskCard("put the red cube on the green cube", horizon=180),
    "Door": TaskCard("turn the handle down and pull the door open", horizon=180),
}


@dataclass(frozen=True)
class Parts:
    """Names in the MuJoCo model, by the names that `privileged_state` gives them."""

    bodies: Mapping[str, str] = field(default_factory=dict)
    sites: Mapping[str, str] = field(default_factory=dict)
    angles: Mapping[str, str] = field(default_factory=dict)
    """Hinge joints."""
    placed: tuple[str, ...] = ()
    """Those of the bodies that resets place, the one that the task is about first."""


PARTS = {
    "Lift": Parts(bodies={"cube": "cube_main"}, placed=("cube",)),
    "Stack": Parts(bodies={"cubeA": "cubeA_main", "cubeB": "cubeB_main"}, placed=("cubeA", "cubeB")),
    "Door": Parts(
        bodies={"door": "Door_door", "latch": "Door_latch"},
        sites={"handle": "Door_handle"},
        angles={"hinge_angle": "Door_hinge", "latch_angle": "Door_latch_joint"},
        placed=("door",),
    ),
}


class RobosuiteSimulation(MujocoSimulation):
    """One task of robosuite, see `adapters.contract.Simulation`."""

    def __init__(self, task: str, view: View) -> None:
        """Build the model, a renderer for `view`, and take one step, on which numba compiles the controller.

        Raises:
            SimulatorUnavailable: robosuite or MuJoCo is missing, or nothing here can render.
        """
        robosuite, mujoco = import_simulator()
        self._env = robosuite.make(
            task,
            robots="Panda",
            control_freq=CONTROL_HZ,
            ignore_done=True,
            hard_reset=False,
            has_renderer=False,
            has_offscreen_renderer=False,
            use_camera_obs=False,
            use_object_obs=False,
            renderer="mujoco",
            seed=BUILD_SEED,
        )
        for name in self._env.observation_names:  # Updated 25 times a control step, and nobody reads them.
            self._env.modify_observable(name, "enabled", False)
        world = self._env.sim.model._model, self._env.sim.data._data
        super().__init__(mujoco, world, view, TASKS[task].instruction)
        self._parts = PARTS[task]

        robot = self._env.robots[0]
        arm = robot.part_controllers["right"]
        share = reached_share(arm.kp[0], CONTROL_HZ)
        self.action_spec = ActionSpec(
            max_translation=share * float(arm.output_max[0]),
            max_rotation=share * float(arm.output_max[3]),
            control_hz=CONTROL_HZ,
        )
        tool = robot.gripper["right"].important_sites["grip_site"], robot.robot_model.eef_name["right"]
        self._take_arm(robot.robot_model.root_body, *tool, robot.gripper["right"].joints)
        frame = BaseFrame(self._base)
        things = {name: self._parts.bodies[name] for name in self._parts.placed}
        cameras = MujocoCameras(self._model, self._base)
        self._lights = MujocoLights(self._model, frame)
        objects = RobosuiteObjects(world, things, self._env.placement_initializer, frame, self._settle)
        arm = MujocoArm(mujoco, world, lambda: robot.part_controllers["right"], tool, frame, self._settle)
        bodies = MujocoBodies(self._model, things.values(), self._settle)
        self._stage = MujocoStage(mujoco, world, frame, self._scene.renderers)
        self.adjusters = Adjusters(cameras, self._lights, objects, arm, bodies, self._stage)
        self._closed = False
        self._env.step(np.zeros(self._env.action_dim))
        self.reset(BUILD_SEED, Condition())
        try:
            self.render_device()
        except SimulatorUnavailable:
            self.close()
            raise

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode of `seed`, from which the objects' placement and the arm's joint noise are drawn."""
        if condition.axis != CLEAN:
            raise UnsupportedCondition(f"robosuite cannot bring about {condition}: this adapter knows clean only")
        self._undo_adjustments()
        generator = np.random.default_rng(seed)
        self._env.rng = generator
        for sampler in samplers(self._env.placement_initializer):
            sampler.rng = generator
        self._env.reset()
        self._settle()

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` for one control step (25 physics steps). Never renders."""
        spec = self.action_spec
        _, reward, _, _ = self._env.step(np.clip(action, spec.low, spec.high) / spec.high)
        # The sparse reward is 1 where the task's predicate holds, else 0. Asking for the predicate would do it twice.
        return StepOutcome(reward=float(reward), success=reward > 0.0)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """The true state: `tcp_*` and `finger_positions`, then by task.

        Lift: `cube_*`. Stack: `cubeA_*` (red, to be put on) and `cubeB_*` (green). Door: `door_*` and `latch_*` (the
        two bodies), `handle_*` (a point near the free end of the handle), `hinge_angle` (1,) (0 closed, success above
        0.3) and `latch_angle` (1,) (0 at rest, positive downwards), rad.
        """
        state = self._arm_state()
        state |= self._poses({name: self._data.body(body) for name, body in self._parts.bodies.items()})
        state |= self._poses({name: self._data.site(site) for name, site in self._parts.sites.items()})
        return state | {name: self._data.joint(joint).qpos.copy() for name, joint in self._parts.angles.items()}

    def close(self) -> None:
        """Free the renderers and the model."""
        if self._closed:
            return
        self._closed = True
        self._scene.close()
        self._env.close()


def samplers(root: Any) -> list[Any]:
    """A placement initializer and those nested in it."""
    return [root, *(inner for child in getattr(root, "samplers", {}).values() for inner in samplers(child))]


def import_simulator() -> tuple[Any, Any]:
    """The modules robosuite and mujoco, with a renderer chosen and the start-up warnings silenced.

    Raises:
        SimulatorUnavailable: One is missing, or MuJoCo finds no way to render.
    """
    mujoco, robosuite = import_with_mujoco("robosuite", "robosuite")
    return robosuite, mujoco


def open_simulation(task: str, view: View) -> RobosuiteSimulation:
    """Open the task of that name (`Lift`, `Stack`, `Door`).

    Raises:
        SimulatorUnavailable: robosuite is missing or cannot render.
    """
    return RobosuiteSimulation(task, view)


SIMULATOR = Simulator(
    name="robosuite",
    title="robosuite 1.5 (MuJoCo)",
    tasks=TASKS,
    modules=("robosuite", "mujoco"),
    distributions=("robosuite", "mujoco", "numba"),
    open=open_simulation,
    adjusts=frozenset({"cameras", "lights", "objects", "arm", "bodies", "stage"}),
    environment={"MUJOCO_GL": "egl"},
)
