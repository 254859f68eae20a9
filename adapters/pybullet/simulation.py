"""PyBullet through panda-gym: a Franka Panda at a table, end-effector control at 25 Hz.

Parts of panda-gym and of this adapter:

- Robot, tasks, goals, success predicates and the controller are panda-gym's. Its episodes end at the first success;
  here only the predicate is used.
- The adapter renders images, since panda-gym's camera makes the 4 cm cube two pixels wide and sets no light. PyBullet's
  TinyRenderer draws the translucent goal as opaque and in the cube's green, so the goal is painted red. `standard`
  draws shadows as panda-gym does, `fast` does not; there are no reflections and no multisampling. `fast-2` also
  simplifies the arm's meshes, which nearly halves the time of a third-person frame; the wrist's shows little of the
  arm. Empty background is white.
- The controller keeps the gripper pointing straight down, so rotations are ignored; in Reach and Push the fingers are
  held closed, so the gripper is ignored too. In one control step the joint motors cover 60 to 100 % of the commanded
  displacement, depending on the direction. The adapter therefore adds up the commands and gives the motors the way to
  the sum, so that later steps cover the rest.
- Poses of links are those of the last of the 20 physics steps in a control step, before its integration (2 ms old), as
  everywhere in panda-gym. Recomputing them would change the controller's next command.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import (
    ActionSpec,
    FloatArray,
    Image,
    Motion,
    SimulatorUnavailable,
    StepOutcome,
    TaskDescription,
)
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.pybullet.arm import BASE_IN_WORLD, FIXED_LINK, JOINTS, PyBulletArm, joint_limits, tool_pose
from robogauntlet.adapters.pybullet.cameras import PyBulletCameras
from robogauntlet.adapters.pybullet.culling import PyBulletCulling
from robogauntlet.adapters.pybullet.dynamics import PyBulletDynamics
from robogauntlet.adapters.pybullet.lights import Lamps, PyBulletLights
from robogauntlet.adapters.pybullet.meshes import arm_to_draw
from robogauntlet.adapters.pybullet.objects import PyBulletObjects
from robogauntlet.adapters.pybullet.table import PyBulletTable
from robogauntlet.adapters.pybullet.tasks import TASKS
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import RenderProfile, View

MAX_LEAD = 0.05
"""Translation of panda-gym's full command, hence the largest distance of the target from the tool (m)."""
MAX_TRANSLATION = 0.03
"""Translation that the arm can follow in every direction (m per control step)."""
WIDTH_PER_COMMAND = 0.2
"""Change of the distance between the fingers by panda-gym's full gripper command (m)."""
MAX_WIDTH = 0.08
"""Distance between the fingers when open (m)."""
GOAL_COLOUR = (0.9, 0.1, 0.1, 1.0)
OUT_OF_REACH = (0.0, 0.0, 5.0)
FINGERS = (9, 10)


class PyBulletSimulation(BaseSimulation):
    """One panda-gym task in its own physics server, see `robogauntlet.adapters.contract.Simulation`."""

    culling = True

    def __init__(self, env: Any, description: TaskDescription, view: View) -> None:
        """Take over `env`, an unwrapped panda-gym environment."""
        ignored = ("rx", "ry", "rz", *(("gripper",) if env.robot.block_gripper else ()))
        action_spec = ActionSpec(MAX_TRANSLATION, 0.0, control_hz=1.0 / env.sim.dt, ignored=ignored)
        super().__init__(view, description.instruction, action_spec)
        self._env = env
        self._robot, self._task, self._sim = env.robot, env.task, env.sim
        self._client = env.sim.physics_client
        self._bodies: Mapping[str, int] = env.sim._bodies_idx
        self._cameras, self._lights = PyBulletCameras(), PyBulletLights()
        # The client looks its functions up anew at each call.
        self._step_physics = self._client.stepSimulation
        self._culling = PyBulletCulling(self._client, self._bodies["panda"])
        self.scene_controls = SceneControls(
            cameras=self._cameras,
            lights=self._lights,
            objects=PyBulletObjects(env),
            arm=PyBulletArm(env, self._hold),
            dynamics=PyBulletDynamics(self._client, self._bodies["object"]) if "object" in self._bodies else None,
            table=PyBulletTable(self._client, self._bodies["table"]),
        )
        self._touchable = {self._bodies[name] for name in ("panda", "object") if name in self._bodies}
        self._limits = joint_limits(env)
        self._target = np.zeros(3)
        self._low, self._high = self.action_spec.low, self.action_spec.high
        self._client.setPhysicsEngineParameter(deterministicOverlappingPairs=1)
        self._client.changeVisualShape(self._bodies["target"], -1, rgbaColor=GOAL_COLOUR)

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`: the state that panda-gym draws from it, without traces of earlier episodes."""
        self.scene_controls.undo()
        self._forget_contacts()
        self._env.reset(seed=seed)
        self._hold(tool_pose(self._env)[0])

    def _hold(self, position: FloatArray) -> None:
        """Make the controller hold a position (3,) of the tool."""
        self._target = position

    def _forget_contacts(self) -> None:
        """Empty the contact caches, which would warm-start the solver with the last episode's forces.

        One physics step without contacts empties them. The order of new contacts depends on history too, hence the
        sorted pairs that are set at opening. Together they make resets bit-identical.
        """
        self._robot.reset()
        if "object" in self._bodies:
            self._sim.set_base_pose("object", OUT_OF_REACH, (0.0, 0.0, 0.0, 1.0))
        self._step_physics()

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` (7,) for one control step. The reward is panda-gym's sparse one: 0 at the goal, else -1."""
        action = np.clip(action, self._low, self._high)
        position, _ = tool_pose(self._env)
        lead = np.clip(self._target + action[:3] - position, -MAX_LEAD, MAX_LEAD)
        self._target = position + lead
        command = lead / MAX_LEAD
        if not self._robot.block_gripper:
            width = MAX_WIDTH * (1.0 - action[6]) / 2.0
            command = np.append(command, (width - self._robot.get_fingers_width()) / WIDTH_PER_COMMAND)
        self._robot.set_action(command)
        for _ in range(self._sim.n_substeps):
            self._step_physics()
        achieved, goal = self._task.get_achieved_goal(), self._task.goal
        reward = float(self._task.compute_reward(achieved, goal, {}))
        return StepOutcome(reward, success=bool(self._task.is_success(achieved, goal)))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return tool, fingers, `goal_position` and, except in Reach, `cube_position` and `cube_quaternion`."""
        position, quaternion = tool_pose(self._env)
        fingers = self._client.getJointStates(self._bodies["panda"], FINGERS)
        state = {
            "tcp_position": position,
            "tcp_quaternion": quaternion,
            "finger_positions": np.array([joint[0] for joint in fingers]),
            "goal_position": self._task.goal - BASE_IN_WORLD,
        }
        if "object" in self._bodies:
            cube_position, cube_quaternion = self._client.getBasePositionAndOrientation(self._bodies["object"])
            state["cube_position"] = np.array(cube_position) - BASE_IN_WORLD
            state["cube_quaternion"] = np.array(cube_quaternion)
        return state

    def motion(self, entries: Sequence[str]) -> Motion:
        """Return tool and fingers, these entries of `privileged_state`, contacts and joint limits."""
        state, robot = self.privileged_state(), self._bodies["panda"]
        joints = np.array([joint[0] for joint in self._client.getJointStates(robot, JOINTS)])
        low, high = self._limits
        # Of a contact: the other body, the robot's link, the normal force (N).
        contacts = [(c[2], c[3], c[9]) for c in self._client.getContactPoints(bodyA=robot)]
        return Motion(
            tool=state["tcp_position"],
            opening=float(state["finger_positions"].sum()),
            entries=tuple(state[entry] for entry in entries),
            contact_force=float(
                sum(f for body, link, f in contacts if body not in self._touchable and link != FIXED_LINK)
            ),
            joint_margin=float(np.minimum(joints - low, high - joints).min()),
        )

    def state_hash(self) -> str:
        """Hash the joints, the cube, the goal and the tool's target."""
        return hash_state(self._physical_state())

    def _physical_state(self) -> dict[str, FloatArray]:
        joints = self._client.getJointStates(self._bodies["panda"], self._robot.joint_indices)
        state = {"joints": np.array([joint[:2] for joint in joints]), "goal": self._task.goal, "target": self._target}
        if "object" in self._bodies:
            body = self._bodies["object"]
            state["cube_pose"] = np.concatenate(self._client.getBasePositionAndOrientation(body))
            state["cube_velocity"] = np.concatenate(self._client.getBaseVelocity(body))
        return state

    def render_device(self) -> str:
        """Return the name of PyBullet's rasteriser, which runs on the processor."""
        return "TinyRenderer"

    def close(self) -> None:
        """Disconnect from the physics server. Safe to call twice."""
        self._env.close()

    def draw(self, camera: str, size: int) -> Image:
        """Render an upright RGB image (size, size, 3) of the present state."""
        pinhole, origin, rotation = self._cameras.camera(camera), np.zeros(3), Rotation.identity()
        if camera == "wrist":
            position, quaternion = tool_pose(self._env)
            origin, rotation = position, Rotation.from_quat(quaternion)
        client = self._client
        view = client.computeViewMatrix(
            cameraEyePosition=rotation.apply(pinhole.eye) + origin + BASE_IN_WORLD,
            cameraTargetPosition=rotation.apply(pinhole.target) + origin + BASE_IN_WORLD,
            cameraUpVector=rotation.apply(pinhole.up),
        )
        projection = client.computeProjectionMatrixFOV(fov=pinhole.fovy, aspect=1.0, nearVal=0.01, farVal=10.0)
        self._culling.leave_out(self._culling.outside(view, projection) if self.culling else ())
        # A coloured light takes each channel from its own image.
        image = np.empty((size, size, 3), dtype=np.uint8)
        for channels, lamps in self._lights.lamps:
            image[..., channels] = self._draw(view, projection, size, lamps)[..., channels]
        return image

    def _draw(self, view: Any, projection: Any, size: int, lamps: Lamps) -> Image:
        """Render with TinyRenderer, (size, size, 4), with a camera's matrices and a light."""
        # Pass all arguments of the light: PyBullet keeps the last value of an omitted one.
        _, _, pixels, _, _ = self._client.getCameraImage(
            width=size,
            height=size,
            viewMatrix=view,
            projectionMatrix=projection,
            lightDirection=lamps.direction,
            lightColor=lamps.colour,
            lightDistance=lamps.distance,
            shadow=self.view.render_profile is RenderProfile.STANDARD,
            lightAmbientCoeff=lamps.ambient,
            lightDiffuseCoeff=lamps.diffuse,
            lightSpecularCoeff=lamps.specular,
            renderer=self._client.ER_TINY_RENDERER,
        )
        return np.asarray(pixels, dtype=np.uint8).reshape(size, size, 4)

    def engine_time(self) -> float:
        """Return the CPU time of PyBullet alone in a control step from the present state (s).

        The state is restored, except for what the solver remembers.
        """
        state, start = self._client.saveState(), time.process_time()
        for _ in range(self._sim.n_substeps):
            self._client.stepSimulation()
        taken = time.process_time() - start
        self._client.restoreState(state)
        self._client.removeState(state)
        return taken


def open(task: str, view: View) -> PyBulletSimulation:
    """Open a task of panda-gym.

    Raises:
        SimulatorUnavailable: pybullet or panda-gym is not installed.
    """
    with _stdout_to_stderr():
        try:
            import gymnasium
            import panda_gym  # noqa: F401  registers the environments
        except ImportError as error:
            raise SimulatorUnavailable(f'{error}; install it: pip install "robogauntlet[pybullet]"') from error
        with arm_to_draw(simplify=view.render_profile is RenderProfile.FAST_2):
            env = gymnasium.make(task, disable_env_checker=True).unwrapped
            return PyBulletSimulation(env, TASKS[task], view)


@contextmanager
def _stdout_to_stderr() -> Iterator[None]:
    """Send the output of PyBullet's C++ code to standard error, as standard output is for results."""
    libc = ctypes.CDLL(None)
    sys.stdout.flush()
    libc.fflush(None)
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        libc.fflush(None)
        os.dup2(saved, 1)
        os.close(saved)
