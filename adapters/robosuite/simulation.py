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

import importlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
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
    SimulatorUnavailable,
    StepOutcome,
    TaskCard,
    UnsupportedCondition,
)
from adapters.frames import axis_angle, hash_state, relative_pose
from adapters.mujoco_scene import drawing_device, import_mujoco, no_rendering
from adapters.robosuite.arm import RobosuiteArm
from adapters.robosuite.bodies import RobosuiteBodies
from adapters.robosuite.cameras import CAMERA_NAMES, RobosuiteCameras
from adapters.robosuite.frame import BaseFrame
from adapters.robosuite.lights import RobosuiteLights
from adapters.robosuite.objects import RobosuiteObjects
from adapters.robosuite.stage import RobosuiteStage
from suites.vocabulary import CLEAN, Condition, RenderProfile, View

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


class RobosuiteSimulation:
    """One task of robosuite, see `adapters.contract.Simulation`."""

    def __init__(self, task: str, view: View) -> None:
        """Build the model, a renderer for `view`, and take one step, on which numba compiles the controller.

        Raises:
            SimulatorUnavailable: robosuite or MuJoCo is missing, or nothing here can render.
        """
        robosuite, self._mujoco = import_simulator()
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
        self._model, self._data = self._env.sim.model._model, self._env.sim.data._data
        self._parts, self._view, self._instruction = PARTS[task], view, TASKS[task].instruction

        robot = self._env.robots[0]
        arm = robot.part_controllers["right"]
        share = float(np.sqrt(arm.kp[0])) / 2.0 / CONTROL_HZ
        self.action_spec = ActionSpec(
            max_translation=share * float(arm.output_max[0]),
            max_rotation=share * float(arm.output_max[3]),
            control_hz=CONTROL_HZ,
        )
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)
        self._base = self._data.body(robot.robot_model.root_body)
        self._tool_centre = self._data.site(robot.gripper["right"].important_sites["grip_site"])
        # The hand, not the site in it: along its y axis the fingers open, as in the other simulators.
        self._hand = self._data.body(robot.robot_model.eef_name["right"])
        self._fingers = [self._data.joint(name) for name in robot.gripper["right"].joints]

        self._option = self._mujoco.MjvOption()
        self._option.geomgroup[0] = 0  # Collision shapes.
        self._renderers: dict[int, Any] = {}
        world, frame = (self._model, self._data), BaseFrame(self._base)
        things = {name: self._parts.bodies[name] for name in self._parts.placed}
        self._cameras = RobosuiteCameras(self._model, self._base)
        self._lights = RobosuiteLights(self._model, frame)
        objects = RobosuiteObjects(world, things, self._env.placement_initializer, frame, self._settle)
        arm = RobosuiteArm(self._mujoco, world, robot, frame, self._settle)
        self._bodies = RobosuiteBodies(self._model, things.values(), self._settle)
        self._stage = RobosuiteStage(self._mujoco, world, frame, self._renderers)
        self.adjusters = Adjusters(
            cameras=self._cameras,
            lights=self._lights,
            objects=objects,
            arm=arm,
            bodies=self._bodies,
            stage=self._stage,
        )
        self._closed = False
        self._env.step(np.zeros(self._env.action_dim))
        self.reset(BUILD_SEED, Condition())
        try:
            self._renderer(view.image_size)
        except Exception as error:  # What MuJoCo and the GL bindings raise here has no common base.
            self.close()
            raise no_rendering(error) from error

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode of `seed`, from which the objects' placement and the arm's joint noise are drawn."""
        if condition.axis != CLEAN:
            raise UnsupportedCondition(f"robosuite cannot bring about {condition}: this adapter knows clean only")
        for adjuster in (self._cameras, self._lights, self._bodies, self._stage):
            adjuster.undo()
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

    def observe(self) -> Observation:
        """Render the cameras of the view and read the proprioception."""
        images = {camera: self._draw(CAMERA_NAMES[camera], self._view.image_size) for camera in self._view.cameras}
        position, quaternion = self._tool_pose()
        proprioception = np.concatenate([position, axis_angle(quaternion), self._finger_positions()])
        return Observation(images, proprioception, self._instruction)

    def picture(self) -> Image:
        """The third-person view, (256, 256, 3)."""
        return self._draw(CAMERA_NAMES["third_person"], PICTURE_SIZE)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """The true state: `tcp_*` and `finger_positions`, then by task.

        Lift: `cube_*`. Stack: `cubeA_*` (red, to be put on) and `cubeB_*` (green). Door: `door_*` and `latch_*` (the
        two bodies), `handle_*` (a point near the free end of the handle), `hinge_angle` (1,) (0 closed, success above
        0.3) and `latch_angle` (1,) (0 at rest, positive downwards), rad.
        """
        self._refresh()
        position, quaternion = self._tool_pose()
        state = {"tcp_position": position, "tcp_quaternion": quaternion, "finger_positions": self._finger_positions()}
        poses = {name: self._data.body(body) for name, body in self._parts.bodies.items()}
        poses |= {name: self._data.site(site) for name, site in self._parts.sites.items()}
        for name, pose in poses.items():
            state[f"{name}_position"], state[f"{name}_quaternion"] = self._in_base(pose.xpos, pose.xmat)
        return state | {name: self._data.joint(joint).qpos.copy() for name, joint in self._parts.angles.items()}

    def state_hash(self) -> str:
        """Hash of all joint positions and velocities, and of where the fixed bodies (the door) were put."""
        return hash_state(
            {
                "qpos": self._data.qpos,
                "qvel": self._data.qvel,
                "body_pos": self._model.body_pos,
                "body_quat": self._model.body_quat,
            }
        )

    def render_device(self) -> str:
        """OpenGL's name of what draws."""
        self._draw(CAMERA_NAMES["third_person"], self._view.image_size)
        return drawing_device()

    def close(self) -> None:
        """Free the renderers and the model."""
        if self._closed:
            return
        self._closed = True
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
        self._env.close()

    def _renderer(self, size: int) -> Any:
        """The renderer for images of `size`, made on first use."""
        if size not in self._renderers:
            visual = self._model.vis
            visual.global_.offwidth, visual.global_.offheight = size, size
            if self._view.render_profile is RenderProfile.FAST:
                visual.quality.offsamples = 0
            renderer = self._mujoco.Renderer(self._model, height=size, width=size)
            if self._view.render_profile is RenderProfile.FAST:
                renderer.scene.flags[self._mujoco.mjtRndFlag.mjRND_SHADOW] = False
                renderer.scene.flags[self._mujoco.mjtRndFlag.mjRND_REFLECTION] = False
            self._renderers[size] = renderer
        return self._renderers[size]

    def _draw(self, camera: str, size: int) -> Image:
        """The world as it is now, (size, size, 3)."""
        self._refresh()
        renderer = self._renderer(size)
        renderer.update_scene(self._data, camera, self._option)
        self._stage.draw(renderer.scene)
        return self._lights.develop(renderer.render())

    def _settle(self) -> None:
        """Bring contacts and forces up to date for a world that was just put together.

        On its way, reset solves the contacts of the last episode's door or of the objects' default poses, and the
        solver starts from its last solution.
        """
        self._data.qacc_warmstart[:] = 0.0
        self._mujoco.mj_forward(self._model, self._data)

    def _refresh(self) -> None:
        """Bring poses up to date: a physics step ends with new joint positions, and the poses of the ones before."""
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)  # Cameras and lights may follow centres of mass.
        self._mujoco.mj_camlight(self._model, self._data)

    def _tool_pose(self) -> tuple[FloatArray, FloatArray]:
        """Position (3,) and quaternion xyzw (4,) of the tool centre point in the base frame."""
        return self._in_base(self._tool_centre.xpos, self._hand.xmat)

    def _finger_positions(self) -> FloatArray:
        """How far each finger is from the middle (m), shape (2,)."""
        return np.abs([finger.qpos[0] for finger in self._fingers])

    def _in_base(self, position: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A world pose as position and quaternion xyzw in the base frame."""
        quaternion = Rotation.from_matrix(matrix.reshape(3, 3)).as_quat()
        return relative_pose(self._base.xpos, self._base_quaternion(), position, quaternion)

    def _base_quaternion(self) -> FloatArray:
        return Rotation.from_matrix(self._base.xmat.reshape(3, 3)).as_quat()


def samplers(root: Any) -> list[Any]:
    """A placement initializer and those nested in it."""
    return [root, *(inner for child in getattr(root, "samplers", {}).values() for inner in samplers(child))]


def import_simulator() -> tuple[Any, Any]:
    """The modules robosuite and mujoco, with a renderer chosen and the start-up warnings silenced.

    Raises:
        SimulatorUnavailable: One is missing, or MuJoCo finds no way to render.
    """
    mujoco = import_mujoco()
    logging.getLogger("robosuite_logs").addFilter(is_error)
    try:
        return importlib.import_module("robosuite"), mujoco
    except ModuleNotFoundError as error:
        raise SimulatorUnavailable(f"{error}: pip install robogauntlet[robosuite]") from error
    except Exception as error:  # It opens a display too; the GL bindings raise what they like.
        raise no_rendering(error) from error


def is_error(record: logging.LogRecord) -> bool:
    """Filter of robosuite's log: its warnings about private macros and optional robots concern nobody here."""
    return record.levelno >= logging.ERROR


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
