"""robosuite (MuJoCo): the Panda at its table with Lift, Stack and Door, under the benchmark's default controller.

Particular to this adapter:

- The controller is OSC_POSE with delta input in the base frame: a critically damped spring between the tool and a goal
  that is set again in each control step, relative to the present pose. In steady motion it covers
  sqrt(kp) / 2 * dt = 31 % of the offset. The adapter commands correspondingly more, so that the tool centre point moves
  by the action; `ActionSpec` states the range that remains. A rotation alone also moves the tool centre point.
- The gripper uses only the sign of its command: it moves by a fixed amount, and does not move at exactly 0.
- The size of Lift's cube is drawn once while the model is built, always from `BUILD_SEED`; robosuite's `hard_reset`
  would draw it in each episode, at a second or more per reset.
- Control steps are run by `mujoco_parts.control`, equal to robosuite's own to the bit.
- `fast` omits shadows, reflections and multisampling, and takes a third to a quarter of the time. `fast-2` also
  simplifies the robot's meshes, which halves that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robogauntlet.adapters import references
from robogauntlet.adapters.contract import ActionSpec, FloatArray, Goal, Simulator, StepOutcome, TaskDescription
from robogauntlet.adapters.mujoco_parts.arm import MujocoArm
from robogauntlet.adapters.mujoco_parts.cameras import MujocoCameras
from robogauntlet.adapters.mujoco_parts.control import ControlLoop, Version
from robogauntlet.adapters.mujoco_parts.dynamics import MujocoDynamics
from robogauntlet.adapters.mujoco_parts.lights import MujocoLights
from robogauntlet.adapters.mujoco_parts.meshes import simplify_meshes
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.mujoco_parts.simulation import MujocoSimulation, import_with_mujoco
from robogauntlet.adapters.mujoco_parts.table import MujocoTable
from robogauntlet.adapters.robosuite.objects import RobosuiteObjects
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import RenderProfile, View

CONTROL_HZ = 20.0
BUILD_SEED = 0
"""Seed with which robosuite builds a model."""

LIFTED = 0.04
"""Height of a cube's centre above the table from which robosuite takes it for lifted (m)."""

TASKS = {
    "Lift": TaskDescription(
        "lift the red cube off the table",
        horizon=80,
        goal=Goal("cube_position", offset=(0.0, 0.0, 0.02), grasped=True),
    ),
    "Stack": TaskDescription(
        "put the red cube on the green cube",
        horizon=180,
        goal=Goal("cubeA_position", "cubeB_position", (0.0, 0.0, 0.045), tolerance=0.02, grasped=True),
    ),
    "Door": TaskDescription(
        "turn the handle down and pull the door open",
        horizon=180,
        goal=Goal("hinge_angle", offset=(0.3,), handle="handle_position"),
    ),
}


@dataclass(frozen=True)
class Parts:
    """Names in `privileged_state` to names in the MuJoCo model."""

    bodies: Mapping[str, str] = field(default_factory=dict)
    sites: Mapping[str, str] = field(default_factory=dict)
    angles: Mapping[str, str] = field(default_factory=dict)
    """Hinge joints."""
    lifted: str = ""
    """The body without which above the table there is no reward."""
    placed: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Bodies that resets place, the main object first, to the bodies that are mounted on each."""


PARTS = {
    "Lift": Parts(bodies={"cube": "cube_main"}, placed={"cube": ()}),
    "Stack": Parts(
        bodies={"cubeA": "cubeA_main", "cubeB": "cubeB_main"}, lifted="cubeA_main", placed={"cubeA": (), "cubeB": ()}
    ),
    "Door": Parts(
        bodies={"door": "Door_door", "latch": "Door_latch"},
        sites={"handle": "Door_handle"},
        angles={"hinge_angle": "Door_hinge", "latch_angle": "Door_latch_joint"},
        placed={"door": ("handle", "latch")},
    ),
}


class RobosuiteSimulation(MujocoSimulation):
    """One task of robosuite, see `robogauntlet.adapters.contract.Simulation`."""

    def __init__(self, task: str, view: View) -> None:
        """Build the model, a renderer for `view`, and take one step, on which numba compiles the controller.

        Raises:
            SimulatorUnavailable: robosuite or MuJoCo is missing, or this machine cannot render.
        """
        mujoco, robosuite = import_with_mujoco("robosuite", "robosuite")
        env = robosuite.make(
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
        robot = env.robots[0]
        controller = robot.part_controllers["right"]
        share = float(np.sqrt(controller.kp[0])) / 2.0 / CONTROL_HZ  # Of an offset, see the module's docstring.
        translation, rotation = (share * float(controller.output_max[i]) for i in (0, 3))
        super().__init__(mujoco, env, view, TASKS[task].instruction, ActionSpec(translation, rotation, CONTROL_HZ))
        if view.render_profile is RenderProfile.FAST_2:
            simplify_meshes(mujoco, self._model)
        self._parts = PARTS[task]
        tool = robot.gripper["right"].important_sites["grip_site"], robot.robot_model.eef_name["right"]
        self._take_arm(robot.robot_model.root_body, *tool, robot.gripper["right"].joints)
        places = {name: self._data.body(body) for name, body in self._parts.bodies.items()}
        places |= {name: self._data.site(site) for name, site in self._parts.sites.items()}
        self._take_objects(
            self._parts.bodies.values(),
            places,
            {name: self._data.joint(joint) for name, joint in self._parts.angles.items()},
        )
        objects = {name: self._parts.bodies[name] for name in self._parts.placed}
        sampler, attached = self._env.placement_initializer, self._parts.placed
        self._lights = MujocoLights(self._physics)
        self._table = MujocoTable(self._physics, self._scene.renderers)
        self.scene_controls = SceneControls(
            cameras=MujocoCameras(self._physics),
            lights=self._lights,
            objects=RobosuiteObjects(self._physics, objects, attached, sampler),
            arm=MujocoArm(self._physics, lambda: robot.part_controllers["right"], tool),
            dynamics=MujocoDynamics(self._physics, objects.values()),
            table=self._table,
        )
        self._control = control_loop(self._physics, env)
        self._control.step(np.zeros(env.action_dim))
        self.reset(BUILD_SEED)
        self._check_rendering()

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, which determines the objects' placement and the arm's joint noise."""
        self.scene_controls.undo()
        generator = np.random.default_rng(seed)
        self._env.rng = generator
        for sampler in samplers(self._env.placement_initializer):
            sampler.rng = generator
        self._env.reset()
        self._physics.settle()

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` for one control step (25 physics steps). Never renders."""
        spec = self.action_spec
        command = np.clip(action, spec.low, spec.high) / spec.high
        self._control.step(command)
        reward = self._reward()
        # The sparse reward is 1 where the task's predicate holds, else 0, so the predicate is computed once.
        return StepOutcome(reward=reward, success=reward > 0.0)

    def _reward(self) -> float:
        """Return robosuite's reward; in most steps without the contacts, which it looks up by name."""
        lifted, env = self._parts.lifted, self._env
        if lifted and self._data.body(lifted).xpos[2] <= env.table_offset[2] + LIFTED:
            return 0.0
        return float(env.reward(None))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return the true state: `tcp_*` and `finger_positions`, then by task.

        Lift: `cube_*`. Stack: `cubeA_*` (red, to be put on) and `cubeB_*` (green). Door: `door_*` and `latch_*` (the
        two bodies), `handle_*` (a point near the free end of the handle), `hinge_angle` (1,) (0 closed, success above
        0.3) and `latch_angle` (1,) (0 at rest, positive downwards), rad.
        """
        state = self.arm_state() | self._poses({name: p for name, p in self._places.items() if name != "tcp"})
        return state | {name: joint.qpos.copy() for name, joint in self._angles.items()}


def control_loop(physics: MujocoPhysics, env: Any) -> ControlLoop:
    """Return the control steps of robosuite 1.5: goals are in the frame of the base, a gripper's command is held."""
    robot = env.robots[0]

    def set_goal(controller: Any, action: FloatArray, steps: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        controller.set_goal(action[: controller.control_dim])
        command = robot.gripper["right"].format_action(action[controller.control_dim :])
        position = controller.origin_pos + np.dot(controller.origin_ori, controller.goal_pos)
        return position, np.dot(controller.origin_ori, controller.goal_ori), np.tile(command, (steps, 1))

    actuators = robot._ref_actuators_indexes_dict["right"], robot._ref_actuators_indexes_dict["right_gripper"]
    tool = "ref_name", "ref_pos", "ref_ori_mat"
    return ControlLoop(physics, env, Version(lambda: robot.part_controllers["right"], tool, actuators, set_goal))


def samplers(root: Any) -> list[Any]:
    """Return a placement initializer and those nested in it."""
    return [root, *(inner for child in getattr(root, "samplers", {}).values() for inner in samplers(child))]


SIMULATOR = Simulator(
    name="robosuite",
    title="robosuite 1.5 (MuJoCo)",
    tasks=TASKS,
    modules=("robosuite", "mujoco"),
    distributions=("robosuite", "mujoco", "numba", "fast-simplification"),
    references=(references.ROBOSUITE, references.MUJOCO),
    open=RobosuiteSimulation,
    adjusts=frozenset({"cameras", "lights", "objects", "arm", "dynamics", "table"}),
    environment={"MUJOCO_GL": "egl"},
)
