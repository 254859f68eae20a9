"""ManiSkill 3 (SAPIEN, PhysX on the CPU): one Panda with a wrist camera, three table-top tasks.

What differs from ManiSkill's own defaults, and why:

- The arm controller (`pd_ee_delta_pose`) is a spring and damper without memory of its last target: in one control step
  it covers 1 - exp(-stiffness/damping * dt) = 39 % of the way commanded. The adapter commands that much more, so that
  the tool centre point moves by the action; `ActionSpec` states what remains of the controller's range.
- The third-person camera looks at the work space from the front left. In ManiSkill's own base cameras the gripper hides
  PushCube's cube, and PullCube's arm is not in the picture.
- Every reset moves the world into a new PhysX scene (0.3 ms). In a scene that is kept, the order in which PhysX solves
  contacts depends on the contacts of earlier episodes, and equal seeds can part when the gripper lets go of a cube.
  Things are woken too: how long PhysX has seen them at rest, after which they sleep, outlasts the scene.

ManiSkill draws sensors with SAPIEN's `minimal` shader: no shadows, reflections or multisampling. There is nothing to
switch off, so the render profiles `standard` and `fast` draw the same.
"""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import (
    PICTURE_SIZE,
    ActionSpec,
    FloatArray,
    Image,
    Observation,
    ObservationSpec,
    Simulator,
    SimulatorUnavailable,
    StepOutcome,
    TaskDescription,
)
from robogauntlet.adapters.frames import hash_state, proprioception, wxyz_to_xyzw
from robogauntlet.adapters.maniskill.arm import ManiSkillArm
from robogauntlet.adapters.maniskill.bodies import ManiSkillBodies, renew_physics, wake
from robogauntlet.adapters.maniskill.cameras import PICTURE, SENSORS, ManiSkillCameras
from robogauntlet.adapters.maniskill.lights import ManiSkillLights
from robogauntlet.adapters.maniskill.objects import ManiSkillObjects
from robogauntlet.adapters.maniskill.stage import ManiSkillStage
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import View

ROBOT = "panda_wristcam"
CONTROLLER_RANGE = 0.1
"""What 1.0 means to ManiSkill's controller: metres per axis, radians of the whole rotation."""
EYE = (0.5, 0.5, 0.5)
"""Third-person camera relative to the point it looks at (m)."""
FIELD_OF_VIEW = 0.75
"""Of the third-person camera, vertical (rad)."""

TASKS = {
    "PushCube-v1": TaskDescription("push the blue cube onto the red and white target", horizon=45),
    "PullCube-v1": TaskDescription("pull the blue cube onto the red and white target", horizon=32),
    "StackCube-v1": TaskDescription("stack the red cube on top of the green cube", horizon=100),
}


@dataclass(frozen=True)
class _Layout:
    """Where a task's things are: ManiSkill's actor names, and what the third-person camera looks at."""

    objects: Mapping[str, str]
    """Our name to ManiSkill's."""
    look_at: tuple[float, float, float]
    """World frame (m): the origin lies on the table, 0.615 m in front of the robot's base."""
    spread: tuple[float, float]
    """Resets put each object's centre within this of the world's origin, along x and y (m)."""
    goal: str | None = None


LAYOUTS = {
    "PushCube-v1": _Layout({"cube": "cube"}, look_at=(0.08, 0.0, 0.05), spread=(0.1, 0.1), goal="goal_region"),
    "PullCube-v1": _Layout({"cube": "cube"}, look_at=(-0.08, 0.0, 0.05), spread=(0.1, 0.1), goal="goal_region"),
    "StackCube-v1": _Layout({"red_cube": "cubeA", "green_cube": "cubeB"}, look_at=(0.0, 0.0, 0.05), spread=(0.2, 0.3)),
}


class ManiSkillSimulation:
    """One ManiSkill task. See `robogauntlet.adapters.contract.Simulation` for what each method promises."""

    def __init__(self, task: str, view: View, env: Any) -> None:
        self._task, self._view, self._env = task, view, env
        spring = env.agent.controller.controllers["arm"].config
        # The force of a spring k with damper d brings the arm exp(-k/d t) close to where it is sent.
        share = 1.0 - np.exp(-spring.stiffness / spring.damping / env.control_freq)
        self._gain = 1.0 / share
        self.action_spec = ActionSpec(
            max_translation=CONTROLLER_RANGE * share,
            max_rotation=CONTROLLER_RANGE * share,
            control_hz=float(env.control_freq),
        )
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)
        layout = LAYOUTS[task]
        self._robot = env.agent.robot._objs[0]
        self._tcp = env.agent.tcp._objs[0]
        self._objects = {name: env.scene.actors[theirs]._objs[0] for name, theirs in layout.objects.items()}
        self._goal = env.scene.actors[layout.goal]._objs[0] if layout.goal else None
        self._base_from_world = self._robot.pose.inv()
        self._low, self._high = self.action_spec.low, self.action_spec.high
        self.scene_controls = SceneControls(
            cameras=ManiSkillCameras(env, self._base_from_world),
            lights=ManiSkillLights(env, self._base_from_world),
            objects=ManiSkillObjects(self._objects, layout.spread, self._base_from_world),
            arm=ManiSkillArm(env, self._base_from_world),
            bodies=ManiSkillBodies(self._objects.values()),
            stage=ManiSkillStage(env, self._base_from_world),
        )

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, in a new PhysX scene."""
        self.scene_controls.undo()
        renew_physics(self._env)
        self._env.reset(seed=seed)
        wake(self._objects.values())

    def observe(self) -> Observation:
        """Render the cameras of the view, and read the robot's proprioception."""
        self._env.scene.update_render()
        images = {name: _capture(self._env.scene.sensors[SENSORS[name]]) for name in self._view.cameras}
        return Observation(images, proprioception(self.privileged_state()), TASKS[self._task].instruction)

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply one action; the reward is ManiSkill's sparse one (1 on success)."""
        action = np.clip(action, self._low, self._high)
        _, _, _, _, info = self._env.step(_command(action, self._gain))
        success = bool(info["success"])
        return StepOutcome(reward=float(success), success=success)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Poses in the base frame, as the contract names them; the goal is the centre of the target's disc."""
        position, quaternion = self._pose(self._tcp.entity_pose)
        state = {
            "tcp_position": position,
            "tcp_quaternion": quaternion,
            "finger_positions": self._robot.qpos[-2:].astype(np.float64),
        }
        for name, entity in self._objects.items():
            state[f"{name}_position"], state[f"{name}_quaternion"] = self._pose(entity.pose)
        if self._goal is not None:
            state["goal_position"], _ = self._pose(self._goal.pose)
        return state

    def state_hash(self) -> str:
        """Hash of joint positions and velocities, and of all actors' poses and velocities, the goal among them."""
        state = self._env.get_state_dict()
        return hash_state(
            {
                f"{kind}/{name}": values.numpy()
                for kind in ("actors", "articulations")
                for name, values in state[kind].items()
            }
        )

    def picture(self) -> Image:
        """The third-person view, (256, 256, 3)."""
        self._env.scene.update_render()
        return _capture(self._env.scene.human_render_cameras[PICTURE])

    def render_device(self) -> str:
        """The Vulkan device, such as `llvmpipe (LLVM 19.1.7, 256 bits)`."""
        import sapien

        return _device_name(sapien.render.get_device_summary())

    def close(self) -> None:
        """Free the scene. Safe to call twice."""
        if self._env is not None:
            self._env.close()
        self._env = self._robot = self._tcp = self._goal = None
        self._objects = {}
        self.scene_controls = SceneControls()

    def _pose(self, pose: Any) -> tuple[FloatArray, FloatArray]:
        """A SAPIEN pose in the world as position (3,) and quaternion xyzw (4,) in the base frame."""
        pose = self._base_from_world * pose
        return pose.p.astype(np.float64), wxyz_to_xyzw(pose.q)


def open_task(task: str, view: View) -> ManiSkillSimulation:
    """Open a task. Costs 3 s for a process' first, 0.2 s then; its first frame without a GPU costs 5 s once.

    Raises:
        SimulatorUnavailable: ManiSkill is not installed, or SAPIEN finds no Vulkan device to render with.
    """
    try:
        import mani_skill.envs  # noqa: F401  (registers the tasks)
        import sapien
        import torch
        from mani_skill.utils.logging_utils import logger
        from mani_skill.utils.registration import REGISTERED_ENVS
        from mani_skill.utils.sapien_utils import look_at
    except ImportError as error:
        raise SimulatorUnavailable(
            f'ManiSkill cannot be imported ({error}); install it: pip install "robogauntlet[maniskill]"'
        ) from error
    # One world has nothing to share among threads, and spinning ones slow other workers down.
    torch.set_num_threads(1)
    # It warns that this robot is not on the tasks' lists. Their scene builder knows it, and gives it its own rest pose.
    logger.setLevel(logging.ERROR)

    centre = np.array(LAYOUTS[task].look_at)
    third_person = {"pose": look_at(centre + EYE, centre).sp, "fov": FIELD_OF_VIEW}
    size = {"width": view.image_size, "height": view.image_size}
    try:
        env = REGISTERED_ENVS[task].cls(
            num_envs=1,
            robot_uids=ROBOT,
            control_mode="pd_ee_delta_pose",
            obs_mode="none",
            reward_mode="none",
            sim_backend="physx_cpu",
            render_backend=_render_backend(sapien),
            sensor_configs={SENSORS["third_person"]: third_person | size, SENSORS["wrist"]: size},
            human_render_camera_configs=third_person
            | {"width": PICTURE_SIZE, "height": PICTURE_SIZE, "shader_pack": "minimal"},
        )
    except RuntimeError as error:
        raise SimulatorUnavailable(f"SAPIEN cannot render here ({error}): {_VULKAN_FIX}") from error
    if not env.scene.can_render():
        env.close()
        raise SimulatorUnavailable(f"SAPIEN found no device to render with: {_VULKAN_FIX}")
    _keep_renderer(env.scene.backend.render_device.name)
    return ManiSkillSimulation(task, view, env)


_VULKAN_FIX = (
    "install a Vulkan driver: that of the GPU's vendor, or without a GPU the Debian packages libvulkan1 and "
    "mesa-vulkan-drivers, version 24.3 or later"
)


def _render_backend(sapien: Any) -> str:
    """`gpu` if SAPIEN can draw on a CUDA device, else `cpu`, which Mesa's lavapipe serves."""
    try:
        return "gpu" if sapien.Device("cuda").can_render() else "cpu"
    except RuntimeError:
        return "cpu"


@functools.cache
def _keep_renderer(device: str) -> Any:
    """A reference that lasts as long as the process.

    With the last scene SAPIEN would free its renderer, and compile its shaders again for the next: 7 s and memory each.
    """
    import sapien

    return sapien.render.RenderSystem(sapien.Device(device))


def _command(action: FloatArray, gain: float) -> Any:
    """Our action (7,) as ManiSkill's normalised one, a tensor (1, 7)."""
    import torch

    command = np.empty((1, 7), dtype=np.float32)
    command[0, :3] = gain / CONTROLLER_RANGE * action[:3]
    # The controller scales rotations by its lower bound, which reverses their sign.
    command[0, 3:6] = _euler_xyz(*(gain * action[3:6]).tolist(), longest=CONTROLLER_RANGE)
    command[0, 3:6] /= -CONTROLLER_RANGE
    command[0, 6] = -action[6]
    return torch.from_numpy(command)


def _euler_xyz(x: float, y: float, z: float, *, longest: float) -> tuple[float, float, float]:
    """Euler angles about x, y', z'' of an axis-angle vector, which is shortened to `longest` (rad) first.

    Plain floats, since SciPy's general conversion costs as much as a tenth of the physics.
    """
    angle = math.hypot(x, y, z)
    if angle < 1e-9:
        return 0.0, 0.0, 0.0
    half = 0.5 * min(angle, longest)
    sine, w = math.sin(half) / angle, math.cos(half)
    x, y, z = x * sine, y * sine, z * sine
    return (
        math.atan2(2 * (x * w - y * z), 1 - 2 * (x * x + y * y)),
        math.asin(2 * (x * z + y * w)),
        math.atan2(2 * (z * w - x * y), 1 - 2 * (y * y + z * z)),
    )


def _capture(camera: Any) -> Image:
    """What a ManiSkill camera sees now, upright RGB."""
    camera.capture()
    rgb = camera.get_obs(rgb=True, depth=False, position=False, segmentation=False)["rgb"]
    return np.array(rgb[0].cpu().numpy(), dtype=np.uint8)


def _device_name(summary: str) -> str:
    """The first device that SAPIEN's summary calls supported."""
    name = "unknown"
    for line in summary.splitlines():
        label, _, value = line.strip().partition(":")
        if label == "GPU":
            name = value.strip()
        elif label == "Supported" and value.strip() == "1":
            return name
    return name


SIMULATOR = Simulator(
    name="maniskill",
    title="ManiSkill 3 (SAPIEN)",
    tasks=TASKS,
    modules=("mani_skill", "sapien", "torch"),
    distributions=("mani-skill", "sapien", "torch"),
    open=open_task,
    adjusts=frozenset({"cameras", "lights", "objects", "arm", "bodies", "stage"}),
    environment={"LP_NUM_THREADS": "1"},
)
