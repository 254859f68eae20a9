"""robosuite (MuJoCo): tasks of one arm and of two, under the benchmark's default controller.

Particular to this adapter:

- The controller is OSC_POSE with delta input in the base frame: a critically damped spring between the tool and a goal
  that is set again in each control step, relative to the present pose. In steady motion it covers
  sqrt(kp) / 2 * dt = 31 % of the offset. The adapter commands correspondingly more, so that the tool centre point moves
  by the action; `ActionSpec` states the range that remains. A rotation alone also moves the tool centre point.
  Other arms are slower to follow (0.21 to 0.25): their share is measured when a task is opened.
- On the IIWA and the XArm7, robosuite ties the controller's frame to the first link; here it is the base, as on others.
- The gripper uses only the sign of its command: it moves by a fixed amount, and does not move at exactly 0.
- The sizes of Lift's cube and TwoArmHandover's hammer are drawn once while the model is built, always from
  `BUILD_SEED`; robosuite's `hard_reset` would draw them in each episode, at a second or more per reset.
- Control steps of one arm are run by `mujoco_parts.control`, equal to robosuite's own to the bit, those of two arms by
  robosuite.
- With actions of joints, steps are those of `mujoco_parts.joint_control`.
- `fast` omits shadows, reflections and multisampling, and takes a third to a quarter of the time. `fast-2` also
  simplifies the robot's meshes, which halves that.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import GRIPPER, ActionSpec, FloatArray, Moves, StepOutcome, names_of_arms
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.motion import standing_still
from robogauntlet.adapters.mujoco_parts.arm import MujocoArm
from robogauntlet.adapters.mujoco_parts.cameras import MujocoCameras
from robogauntlet.adapters.mujoco_parts.control import ControlLoop, Version
from robogauntlet.adapters.mujoco_parts.dynamics import MujocoDynamics
from robogauntlet.adapters.mujoco_parts.fingers import Pads
from robogauntlet.adapters.mujoco_parts.joint_control import JointControl, joints_of
from robogauntlet.adapters.mujoco_parts.lights import MujocoLights
from robogauntlet.adapters.mujoco_parts.meshes import simplify_meshes
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.mujoco_parts.simulation import MujocoSimulation, import_with_mujoco, model_of
from robogauntlet.adapters.mujoco_parts.table import MujocoTable
from robogauntlet.adapters.package_files import files_of
from robogauntlet.adapters.robosuite import droid
from robogauntlet.adapters.robosuite.arms import ARMS, DROID, MOVED_BY_JOINTS, PANDA, TWO_PANDAS, split_arm
from robogauntlet.adapters.robosuite.objects import RobosuiteObjects
from robogauntlet.adapters.robosuite.tasks import HELD, PARTS, TASKS
from robogauntlet.adapters.robosuite.wiping import Dirt
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import RenderProfile, View

CONTROL_HZ, JOINT_CONTROL_HZ = 20.0, 15.0
"""Control steps per second; by joints as many as on DROID's arm."""
BUILD_SEED = 0
"""Seed with which robosuite builds a model."""

RUN_UP, MEASURED = 8, 5
"""Control steps until a motion is steady, and over which it is measured."""
CLOSING_STEPS = 40
"""Control steps in which any gripper closes."""
LIFTED = 0.04
"""Height of a cube's centre above the table from which robosuite takes it for lifted (m)."""


class RobosuiteSimulation(MujocoSimulation):
    """One task of robosuite, see `robogauntlet.adapters.contract.Simulation`."""

    _joints: JointControl | None = None
    _control: Any

    def __init__(self, task: str, view: View) -> None:
        """Build the model, a renderer for `view`, and take one step, on which numba compiles the controller.

        Raises:
            SimulatorUnavailable: robosuite, a file of it or MuJoCo is missing, or this machine cannot render.
        """
        mujoco, robosuite = import_with_mujoco("robosuite", "robosuite")
        name, robot_name, moves = split_arm(task)
        arms, by_joints = TASKS[task].arms, moves is not Moves.TOOL
        arm = MOVED_BY_JOINTS[robot_name] if by_joints else ARMS[PANDA if robot_name == TWO_PANDAS else robot_name]
        kind = PANDA if robot_name == TWO_PANDAS else arm.robot or robot_name
        hz = JOINT_CONTROL_HZ if by_joints else CONTROL_HZ
        with files_of("robosuite"):
            env = robosuite.make(
                name,
                robots=[kind] * arms,
                gripper_types=HELD.get(name, arm.gripper),
                control_freq=hz,
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
        ignored = names_of_arms((GRIPPER,), arms) if name in HELD else ()
        spec = ActionSpec(translation, rotation, hz, ignored, arms)
        if by_joints:
            joints = joints_of(robot, env.sim.model._model)
            spec = ActionSpec(0.0, 0.0, hz, arms=arms, joints=joints, velocities=moves is Moves.VELOCITIES)
        super().__init__(mujoco, *model_of(env), view, TASKS[task].instruction, spec)
        self._env = env
        if view.render_profile is RenderProfile.FAST_2:
            simplify_meshes(mujoco, self._model)
        self._parts = PARTS[name]
        tools = [
            (one.gripper["right"].important_sites["grip_site"], one.robot_model.eef_name["right"]) for one in env.robots
        ]
        for one, tool in zip(env.robots, tools, strict=True):
            gripper = one.gripper["right"]
            self._take_arm(one.robot_model.root_body, *tool, gripper.joints, arm.fingertips(gripper))
        self._dirt = Dirt(self._physics, env) if name == "Wipe" else None
        places = {name: self._data.body(body) for name, body in self._parts.bodies.items()}
        places |= {name: self._data.body(body) for name, body in self._parts.marks.items()}
        places |= {name: self._data.site(site) for name, site in self._parts.sites.items()}
        self._take_objects(
            self._parts.bodies.values(),
            places,
            {name: self._data.joint(joint) for name, joint in self._parts.angles.items()},
        )
        objects = {name: self._parts.bodies[name] for name in self._parts.placed}
        sampler, attached = getattr(env, "placement_initializer", None), self._parts.placed
        moved = (objects or self._parts.bodies).values()
        self._lights = MujocoLights(self._physics)
        self._table = None if "table" in TASKS[task].fixed else MujocoTable(self._physics, self._scene.renderers)
        cameras = MujocoCameras(self._physics)
        if robot_name == DROID:
            droid.set_up(robot, self._model, cameras)
        self.scene_controls = SceneControls(
            cameras=cameras,
            lights=self._lights,
            objects=RobosuiteObjects(self._physics, objects, attached, sampler) if objects else None,
            arm=MujocoArm(self._physics, self._controller, tools[0]) if arms == 1 else None,
            dynamics=MujocoDynamics(self._physics, moved) if moved else None,
            table=self._table,
        )
        if by_joints:
            self._control = self._joints = JointControl(self._physics, env.robots, spec)
        else:
            base = robot.robot_model.root_body
            fix_frame(self._model, f"{controller.naming_prefix}{controller.part_name}_center", base)
            self._control = control_loop(self._physics, env) if arms == 1 and not ignored else env
            self._control.step(np.zeros(env.action_dim))
        self.reset(BUILD_SEED)
        if kind != PANDA and not by_joints:
            self.action_spec = ActionSpec(*self._measured_bounds(controller.output_max), CONTROL_HZ)
        if self._joints or isinstance(self._arms[0].fingers, Pads):
            self._measure_grippers()
        self.reset(BUILD_SEED)
        self._check_rendering()

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, which determines the objects' placement and the arm's joint noise."""
        self.scene_controls.undo()
        generator = np.random.default_rng(seed)
        self._env.rng = generator
        if self._dirt:
            self._dirt.draw_from(generator)
        for sampler in samplers(getattr(self._env, "placement_initializer", None)):
            sampler.rng = generator
            for thing in sampler.mujoco_objects:
                if hasattr(thing, "rng"):  # The hammer draws the side on which it lies from that of its construction.
                    thing.rng = generator
        self._env.reset()
        self._physics.settle()
        if self._joints:
            self._joints.begin()

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` for one control step (25 physics steps, by joints 33). Never renders."""
        spec = self.action_spec
        command = np.clip(action, spec.low, spec.high)
        self._control.step(command if self._joints else np.delete(command / spec.high, spec.ignored_indices))
        reward = self._reward()
        # The sparse reward is 1 where the task's predicate holds, else the share of objects that are in their places.
        return StepOutcome(reward=reward, success=reward >= 1.0)

    def _controller(self) -> Any:
        """Return the controller of the arm: that of joints, or robosuite's, of which each reset creates one."""
        return self._joints or self._env.robots[0].part_controllers["right"]

    def _measured_bounds(self, largest: FloatArray) -> tuple[float, float]:
        """Return the largest translation (m) and rotation (rad) of a step in steady motion, by those of the goal.

        Means over the axes, both ways except down to the table, rounded so that processors agree.
        """
        shares: tuple[list[float], list[float]] = ([], [])
        for axis, sign in ((axis, sign) for axis in range(6) for sign in (1.0, -1.0) if (axis, sign) != (2, -1.0)):
            self.reset(BUILD_SEED)
            command = np.zeros(self._env.action_dim)
            command[axis] = 0.5 * sign
            for _ in range(RUN_UP):
                self._control.step(command)
            start, start_rotation = self._tool_pose()
            for _ in range(MEASURED):
                self._control.step(command)
            end, end_rotation = self._tool_pose()
            change = np.concatenate([end - start, (end_rotation * start_rotation.inv()).as_rotvec()])
            shares[axis // 3].append(change[axis] / (MEASURED * command[axis] * largest[axis]))
        translation, rotation = (round(float(np.mean(share)), 2) for share in shares)
        return translation * float(largest[0]), rotation * float(largest[3])

    def _tool_pose(self) -> tuple[FloatArray, Rotation]:
        state = self.arm_state()
        return state["tcp_position"], Rotation.from_quat(state["tcp_quaternion"])

    def _measure_grippers(self) -> None:
        """Measure empty grippers when closed, by joints also when open, rounded so that processors agree."""
        for end, command in enumerate((-1.0, 1.0)):
            if command < 0.0 and not self._joints:
                continue
            self.reset(BUILD_SEED)
            action = standing_still(self)
            action[[place for place, name in enumerate(self.action_spec.names) if name.endswith(GRIPPER)]] = command
            for _ in range(CLOSING_STEPS):
                self.step(action)
            if self._joints:
                self._joints.take_gripper_ends(end)
        self._refresh()
        if isinstance(fingers := self._arms[0].fingers, Pads):
            fingers.closed = round(fingers.gap(), 4)

    def _reward(self) -> float:
        """Return robosuite's reward; in most steps without the contacts, which it looks up by name."""
        lifted, env = self._parts.lifted, self._env
        if self._dirt:
            return self._dirt.wipe()
        if lifted and self._data.body(lifted).xpos[2] <= env.table_offset[2] + LIFTED:
            return 0.0
        return float(env.reward(None))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return the true state: `tcp_*` and `finger_positions`, then by task.

        Lift: `cube_*`. Stack: `cubeA_*` (red, to be put on) and `cubeB_*` (green). Door: `door_*` and `latch_*` (the
        two bodies), `handle_*` (a point near the free end of the handle), `hinge_angle` (1,) (0 closed, success above
        0.3) and `latch_angle` (1,) (0 at rest, positive downwards), rad. PickPlace: `can_*` and so on, and `goal_*`
        (its place in the bin). NutAssembly: `nut_*` (the middle of the hole) and `peg_*`. Where there are several, each
        has its own: `can_goal_*`, `square_nut_*`, `square_peg_*` and so on. TwoArmLift: `pot_*`, `handle0_*` and
        `handle1_*` (`handle0` is for the first arm), `second_base_*`. TwoArmHandover: `hammer_*` (the middle of its
        handle, whose z axis points at the head), `second_base_*`. TwoArmPegInHole: `peg_*` (its axis is z), `plate_*`
        (whose normal is z), `second_base_*`. Wipe: `dirt_places` (n, 3) and `dirt_wiped` (n,), 1 or 0. ToolHang:
        `frame_*`, `wrench_*` (the middle of its handle), `stand_*`.
        """
        state = self.arm_state() | self._poses({name: p for name, p in self._places.items() if name != "tcp"})
        state |= {name: joint.qpos.copy() for name, joint in self._angles.items()}
        return state | self._dirt.state() if self._dirt else state

    def state_hash(self) -> str:
        """Hash what `MujocoSimulation` does, and what of the dirt is wiped off."""
        own = super().state_hash()
        return hash_state({own: self._dirt.wiped()}) if self._dirt else own


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


def fix_frame(model: Any, site: str, base: str) -> None:
    """Bring the site whose frame the controller's input is in to the robot's base, if it is on a link that moves."""
    frame, body = model.site(site), model.body(base)
    if model.body_weldid[frame.bodyid[0]]:
        frame.bodyid[:], frame.pos[:], frame.quat[:] = body.id, 0.0, (1.0, 0.0, 0.0, 0.0)
        model.site_sameframe[frame.id] = 0


def samplers(root: Any) -> list[Any]:
    """Return a placement initializer, if there is one, and those nested in it."""
    if root is None:
        return []
    return [root, *(inner for child in getattr(root, "samplers", {}).values() for inner in samplers(child))]
