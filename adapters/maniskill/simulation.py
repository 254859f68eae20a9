"""ManiSkill 3 (SAPIEN, PhysX on the CPU): one Panda with a wrist camera or two, table-top tasks.

What differs from ManiSkill's own defaults, and why:

- The arm controller (`pd_ee_delta_pose`) is a spring and damper without memory of its last target: in one control step
  it covers 1 - exp(-stiffness/damping * dt) = 39 % of the commanded offset. The adapter commands correspondingly more,
  so that the tool centre point moves by the action; `ActionSpec` states the range that remains.
- The third-person camera looks at the workspace from the front left. In ManiSkill's own cameras the gripper hides
  PushCube's cube, and PullCube's arm is outside the image.
- Every reset moves all entities into a new PhysX scene (0.3 ms). Otherwise the order in which PhysX solves contacts
  would depend on earlier episodes, and equal seeds could differ after the gripper releases a cube. Objects are woken
  too, since the time for which PhysX has seen them at rest, after which they sleep, outlasts the scene.

Sensors are rendered with SAPIEN's `minimal` shader, without shadows, reflections or multisampling, so the render
profiles `standard` and `fast` are equal. `fast-2` draws the robot with fewer triangles.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import PICTURE_SIZE, ActionSpec, FloatArray, Image, Motion, Observation, StepOutcome
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.maniskill.arm import ManiSkillArm
from robogauntlet.adapters.maniskill.cameras import PICTURE, SENSORS, ManiSkillCameras, sensor_of
from robogauntlet.adapters.maniskill.contacts import ManiSkillContacts
from robogauntlet.adapters.maniskill.culling import ManiSkillCulling
from robogauntlet.adapters.maniskill.dynamics import ManiSkillDynamics, renew_physics, wake
from robogauntlet.adapters.maniskill.environment import make_environment, render_device
from robogauntlet.adapters.maniskill.lights import ManiSkillLights
from robogauntlet.adapters.maniskill.meshes import simplify_links
from robogauntlet.adapters.maniskill.objects import ManiSkillObjects
from robogauntlet.adapters.maniskill.robot import robots_of
from robogauntlet.adapters.maniskill.table import ManiSkillTable
from robogauntlet.adapters.maniskill.tasks import LAYOUTS, TASKS
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import RenderProfile, View

ROBOT = "panda_wristcam"
FIELD_OF_VIEW = 0.75
"""Vertical field of view of the third-person camera (rad)."""


class ManiSkillSimulation(BaseSimulation):
    """One task of ManiSkill, see `robogauntlet.adapters.contract.Simulation`."""

    culling: bool = True
    """Whether links outside the view are left out, which changes no pixel."""

    def __init__(self, task: str, view: View, env: Any) -> None:
        self._env = env
        self._arms = robots_of(env)
        reach = self._arms[0].reach
        spec = ActionSpec(reach, reach, float(env.control_freq), arms=len(self._arms))
        super().__init__(view, TASKS[task].instruction, spec)
        layout = LAYOUTS[task]
        self._objects = {name: env.scene.actors[theirs]._objs[0] for name, theirs in layout.objects.items()}
        self._fixtures = {name: env.scene.actors[theirs]._objs[0] for name, theirs in layout.fixtures.items()}
        self._goal = env.scene.actors[layout.goal]._objs[0] if layout.goal else None
        self._places = {**self._objects, **self._fixtures, "goal": self._goal}
        articulations = [arm.articulation for arm in self._arms]
        self._contacts = ManiSkillContacts(articulations, self._objects.values())
        self._low, self._high = self.action_spec.low, self.action_spec.high
        self._culling: Any = ManiSkillCulling(articulations)
        base_from_world, alone = self._arms[0].base_from_world, len(self._arms) == 1
        self.scene_controls = SceneControls(
            cameras=ManiSkillCameras(env, base_from_world),
            lights=ManiSkillLights(env, base_from_world, layout.usual_pixel),
            objects=ManiSkillObjects(self._objects, layout.regions, base_from_world) if layout.regions else None,
            arm=ManiSkillArm(env, base_from_world) if alone else None,
            dynamics=ManiSkillDynamics(env, self._objects.values()),
            table=ManiSkillTable(env, base_from_world),
        )

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, in a new PhysX scene."""
        self.scene_controls.undo()
        renew_physics(self._env)
        self._env.reset(seed=seed)
        wake(self._objects.values())

    def observe(self) -> Observation:
        """Update the renderer once, then render the cameras of the view and read the arm."""
        self._env.scene.update_render()
        return super().observe()

    def draw(self, camera: str, size: int) -> Image:
        """Render a camera of the view. ManiSkill fixes the size of its cameras when the task is opened."""
        return self._capture(self._env.scene.sensors[sensor_of(self._env, camera)])

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` for one control step. The reward is ManiSkill's sparse one (1 on success)."""
        action = np.clip(action, self._low, self._high)
        for arm, own in zip(self._arms, np.split(action, len(self._arms)), strict=True):
            arm.command(own)
        for _ in range(self._env.sim_freq // self._env.control_freq):
            self._env.scene.step()
        success = bool(self._env.evaluate()["success"])
        return StepOutcome(reward=float(success), success=success)

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return tool, fingers, objects and goal, which is the centre of the target's disc or ball."""
        first = self._arms[0]
        state = {name: value for arm in self._arms for name, value in arm.state().items()}
        if len(self._arms) == 2:
            state["second_base_position"], state["second_base_quaternion"] = first.pose(self._arms[1].articulation.pose)
        for name, entity in (self._objects | self._fixtures).items():
            state[f"{name}_position"], state[f"{name}_quaternion"] = first.pose(entity.pose)
        if self._goal is not None:
            state["goal_position"] = first.position(self._goal.pose)
        return state

    def motion(self, entries: Sequence[str]) -> Motion:
        """Return tool and fingers, these entries of `privileged_state`, contacts and joint limits."""
        return Motion(
            tool=self._arms[0].tool_position(),
            opening=self._arms[0].opening(),
            entries=tuple(map(self._position, entries)),
            contact_force=self._contacts.contact_force(self._env.scene.px),
            joint_margin=self._contacts.joint_margin(),
        )

    def _position(self, entry: str) -> FloatArray:
        """Return a position of `privileged_state`, (3,), without the rest."""
        name, first = entry.removesuffix("_position"), self._arms[0]
        return first.tool_position() if name == "tcp" else first.position(self._places[name].pose)

    def state_hash(self) -> str:
        """Hash joint positions and velocities, and the poses and velocities of all actors, including the goal."""
        state = self._env.get_state_dict()
        kinds = ("actors", "articulations")
        return hash_state({f"{kind}/{name}": value.numpy() for kind in kinds for name, value in state[kind].items()})

    def picture(self) -> Image:
        """Render the third-person view, (256, 256, 3)."""
        self._env.scene.update_render()
        return self._capture(self._env.scene.human_render_cameras[PICTURE])

    def render_device(self) -> str:
        """Return the name of the Vulkan device, such as `llvmpipe (LLVM 19.1.7, 256 bits)`."""
        return render_device()

    def close(self) -> None:
        """Free the scene. Safe to call twice."""
        if self._env is not None:
            self._env.close()
        self._env = self._goal = self._culling = None
        self._arms, self._objects, self._fixtures, self._places = [], {}, {}, {}
        self.scene_controls = SceneControls()

    def engine_time(self) -> float:
        """Return the CPU time of PhysX alone in a control step from the present state (s).

        The state is restored, except for what the solver remembers.
        """
        physics = self._env.scene.px
        state, start = physics.pack(), time.process_time()
        for _ in range(self._env.sim_freq // self._env.control_freq):
            physics.step()
        taken = time.process_time() - start
        physics.unpack(state)
        return taken

    def _capture(self, sensor: Any) -> Image:
        """Return the present upright RGB image of one of ManiSkill's cameras."""
        camera = sensor.camera._render_cameras[0]
        with self._culling.seen_by(camera) if self.culling else nullcontext():
            camera.take_picture()
        return np.array(camera.get_picture("Color")[..., :3])


def open_task(task: str, view: View) -> ManiSkillSimulation:
    """Open a task. The first in a process takes 3 s, later ones 0.2 s.

    Raises:
        SimulatorUnavailable: ManiSkill or a file of it is missing, or SAPIEN finds no Vulkan device to render with.
    """
    layout, alone = LAYOUTS[task], TASKS[task].arms == 1

    def cameras(look_at: Any) -> dict[str, Any]:
        centre = np.array(layout.look_at)
        third_person = {"pose": look_at(centre + layout.eye, centre).sp, "fov": FIELD_OF_VIEW}
        size = {"width": view.image_size, "height": view.image_size}
        wrist = SENSORS["wrist"] if alone else f"{ROBOT}-0-{SENSORS['wrist']}"
        return {
            "sensor_configs": {SENSORS["third_person"]: third_person | size, wrist: size},
            # Mounted on nothing: PlugCharger's own camera moves with the socket.
            "human_render_camera_configs": third_person
            | {"width": PICTURE_SIZE, "height": PICTURE_SIZE, "shader_pack": "minimal", "mount": None},
        }

    robots = ROBOT if alone else (ROBOT, ROBOT)
    env = make_environment(task, cameras, robot_uids=robots, control_mode="pd_ee_delta_pose", reward_mode="none")
    if view.render_profile is RenderProfile.FAST_2:
        for arm in robots_of(env):
            simplify_links(arm.articulation)
    return ManiSkillSimulation(task, view, env)
