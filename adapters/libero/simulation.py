"""LIBERO (robosuite 1.4, MuJoCo): 130 tasks of a Panda at a table, with fifty stored initial states each.

**What a seed means.** Seed s starts from stored state s, modulo 50. A stored state holds the poses of the arm, the
objects and the joints of fixtures, but not of the fixtures (cabinet, stove, microwave, rack): LIBERO draws those, up to
1.9 cm apart, from NumPy's global generator, which the adapter seeds with s during the reset. Seeds from 1,000,000 on,
which are for training, start from LIBERO's own placement of everything, so that no demonstration starts as an
evaluation does. Seeds from 50 on repeat the stored states with other poses of the fixtures, and in tasks without
fixtures repeat the episodes of 0 to 49: suites with such seeds are refused.

Particular to this adapter:

- After the stored state is set, ten control steps with the gripper opening let objects come to rest, as in LIBERO's and
  OpenVLA's evaluations; while an object still moves there are more, up to `PATIENCE`, after which the seed is refused.
- The controller is OSC_POSE with delta input: a spring between the tool and a goal that is set again in each control
  step, relative to the present pose. In steady motion the tool covers `REACHED` of the offset. The adapter commands
  correspondingly more, so that the tool moves by the action. LIBERO's own actions are shares of `action_spec.high`: an
  action of 1 is an offset of 5 cm and 0.5 rad, of which the tool moves 1.31 cm and 0.118 rad in a control step.
- Control steps are run by `mujoco_parts.control`, equal to LIBERO's own to the bit.
- The adapter renders images instead of robosuite 1.4, which never makes its OpenGL context current again and so renders
  the wrong model once a process has had two. The images are bit-identical, but upright.
- Resets are soft. LIBERO's hard reset, its default, builds a new model and appends a sampler of drawers and doors each
  time, which draws more numbers: equal seeds then give different states.
- A soft reset keeps the gripper's last command, so the adapter clears it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, AdapterError, FloatArray, StepOutcome
from robogauntlet.adapters.libero.libero_import import Libero, import_libero, silenced
from robogauntlet.adapters.libero.objects import LiberoObjects, libero_object
from robogauntlet.adapters.libero.tasks import STORED_STATES, TABLES, LiberoTask, libero_tasks
from robogauntlet.adapters.mujoco_parts.arm import MujocoArm
from robogauntlet.adapters.mujoco_parts.cameras import MujocoCameras
from robogauntlet.adapters.mujoco_parts.control import ControlLoop, Version
from robogauntlet.adapters.mujoco_parts.dynamics import MujocoDynamics
from robogauntlet.adapters.mujoco_parts.lights import MujocoLights
from robogauntlet.adapters.mujoco_parts.meshes import simplify_meshes
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.mujoco_parts.simulation import MujocoSimulation, model_of
from robogauntlet.adapters.mujoco_parts.table import MujocoTable
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import FIRST_TRAINING_SEED, RenderProfile, View

CONTROL_HZ = 20.0
REACHED = (0.262, 0.236)
"""Measured share of a translation and of a rotation that the tool covers in a control step of steady motion (along the
axes 25.4 to 26.9 % and 23.0 to 25.1 %). A critically damped spring gives s / (1 + s / 2) = 26.5 % with
s = sqrt(150) / 2 / 20; friction in the joints explains the rest."""
SETTLING = 10
"""Control steps after the stored state is set, before the episode begins."""
PATIENCE = 40
"""Control steps after which objects must be at rest."""
AT_REST = 0.05
"""Largest speed of an object at rest (m/s)."""
STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])
FIRST_RESAMPLED = 500_000
"""Seed from which starts are drawn that are neither stored nor for training."""
PLACEMENTS = 100
"""Attempts of LIBERO to place its objects before a reset fails; LIBERO itself has no limit."""


class LiberoSimulation(MujocoSimulation):
    """One task of LIBERO, see `robogauntlet.adapters.contract.Simulation`."""

    def __init__(self, package: Libero, task: LiberoTask, view: View) -> None:
        """Build the model, a renderer for `view`, and take one step, on which numba compiles the controller.

        Raises:
            SimulatorUnavailable: This machine cannot render.
        """
        with silenced():
            env = package.environment(
                bddl_file_name=str(package.description(task.libero_suite, task.name)),
                control_freq=CONTROL_HZ,
                ignore_done=True,
                hard_reset=False,
                has_offscreen_renderer=False,
                use_camera_obs=False,
            ).env
        robot = env.robots[0]
        limits = robot.controller.output_max
        spec = ActionSpec(REACHED[0] * float(limits[0]), REACHED[1] * float(limits[3]), CONTROL_HZ)
        super().__init__(package.mujoco, *model_of(env), view, task.instruction, spec)
        self._env = env
        if view.render_profile is RenderProfile.FAST_2:
            simplify_meshes(package.mujoco, self._model, textured=True)
        self._states = package.stored_states(task.libero_suite, task.name)
        expected = (STORED_STATES, 1 + self._model.nq + self._model.nv)
        if self._states.shape != expected:
            raise AdapterError(
                f"libero/{task.task}: expected stored states of shape {expected}, found {self._states.shape}: "
                "install assets and package of the same version"
            )

        tool = robot.gripper.important_sites["grip_site"], robot.robot_model.eef_name
        self._take_arm(robot.robot_model.root_body, *tool, robot.gripper.joints)
        self._objects = {name: libero_object(self._model, self._data, name) for name in self._env.objects_dict}
        self._poses_of, self._angles_of, self._goal = fixtures_of(self._env)
        touched = [f"{name}_main" for name in self._objects]
        touched += [self._env.fixtures_dict[name].root_body for name in task.fixtures]
        self._take_objects(touched, self._objects | self._poses_of | {"goal": self._goal}, self._angles_of)
        bodies = [f"{name}_main" for name in task.objects]
        physics = self._physics
        self._lights = key_light(self._env, physics)
        self._table = MujocoTable(physics, self._scene.renderers) if task.arena in TABLES else None
        movable = {name: self._objects[name] for name in task.placeable}
        self.scene_controls = SceneControls(
            cameras=MujocoCameras(physics),
            lights=self._lights,
            objects=LiberoObjects(physics, movable, self._states) if movable else None,
            arm=MujocoArm(physics, lambda: self._env.robots[0].controller, tool),
            dynamics=MujocoDynamics(physics, bodies) if bodies else None,
            table=self._table,
            starts=self,
        )
        self._control = control_loop(physics, self._env)
        self._assets = str(package.assets)
        self._task, self._shift = task, 0.0
        self.reset(0)
        self._check_rendering()

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`: stored state `seed` modulo 50, fixtures placed by `seed`, and settling.

        Seeds for training, from `FIRST_TRAINING_SEED` on, place everything.

        Raises:
            AdapterError: An object does not come to rest.
        """
        self._start(seed, stored=seed < FIRST_TRAINING_SEED)

    def resample(self, seed: int) -> None:
        """Start from a placement of its own instead of the stored state of `seed`, see `scene_control.Starts`.

        Raises:
            AdapterError: An object does not come to rest.
        """
        self._start(FIRST_RESAMPLED + seed, stored=False)

    def _start(self, seed: int, *, stored: bool) -> None:
        self.scene_controls.undo()
        for robot in self._env.robots:
            robot.gripper.current_action = np.zeros(robot.gripper.dof)
        start = f"the placement of seed {seed}"
        if not stored:  # LIBERO adds up where a fixture is and where its parts are, as in a new model.
            for fixture in self._env.fixtures_dict.values():
                body = self._model.body(fixture.root_body)
                body.pos[:], body.quat[:] = 0.0, (1.0, 0.0, 0.0, 0.0)
        with seeded(seed):
            self._place()
        if stored:
            start = f"stored state {seed % STORED_STATES}"
            self._env.sim.set_state_from_flattened(self._states[seed % STORED_STATES])
        self._env.sim.forward()
        self._env._check_success()  # As in LIBERO's `set_init_state`; it affects the images.
        self._env._post_process()
        self._come_to_rest(start)

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` for one control step (25 physics steps). Never renders."""
        spec = self.action_spec
        return self._step(np.clip(action, spec.low, spec.high) / spec.high)

    def _step(self, action: FloatArray) -> StepOutcome:
        self._control.step(action)
        reward, _, _ = self._env._post_action(action)
        return StepOutcome(reward=float(reward), success=bool(self._env._check_success()))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return the true state: `tcp_*` and `finger_positions`, then the task's entries, under LIBERO's names.

        The centre of every object (`akita_black_bowl_1_*`), every body of a fixture
        (`wooden_cabinet_1_cabinet_top_*`), fixtures' joints (`wooden_cabinet_1_top_level`, (1,), m or rad), and
        `goal_position`, of the object or place in the first of the goal's predicates. `settling_shift` (1,) is the
        largest horizontal distance that an object moved while settling (m), since a few stored states are not stable.
        """
        state = self.arm_state() | self._poses(self._objects | self._poses_of)
        state |= {name: joint.qpos.copy() for name, joint in self._angles_of.items()}
        state["goal_position"], _ = self._physics.pose_from_world(self._goal.xpos, self._goal.xmat)
        return state | {"settling_shift": np.array([self._shift])}

    def render_device(self) -> str:
        """Return OpenGL's name of the renderer, and the assets."""
        return f"{super().render_device()}, {self._assets}"

    def _place(self) -> None:
        """Run LIBERO's own reset. A stored state then moves all that it placed, except fixtures."""
        from robosuite.utils.errors import RandomizationError

        for _ in range(PLACEMENTS):
            try:
                self._env.reset()
            except RandomizationError:
                continue
            return
        raise AdapterError(f"libero/{self._task.task}: LIBERO found no room for its objects in {PLACEMENTS} attempts")

    def _come_to_rest(self, start: str) -> None:
        before = self._sites()
        for step in range(PATIENCE):
            if step >= SETTLING and self._fastest() <= AT_REST:
                break
            self._step(STILL)
        else:
            raise AdapterError(
                f"libero/{self._task.task}: {start} does not come to rest within {PATIENCE} steps; leave this seed out"
            )
        self._shift = float(np.linalg.norm(self._sites() - before, axis=1).max())

    def _sites(self) -> FloatArray:
        """Return x and y of the movable objects, (n, 2)."""
        self._refresh()
        return np.array([movable.body.xpos[:2] for movable in self._objects.values()])

    def _fastest(self) -> float:
        """Return the largest speed of a movable object (m/s)."""
        starts = [self._model.body_dofadr[movable.body.id] for movable in self._objects.values()]
        return float(max(np.linalg.norm(self._data.qvel[start : start + 3]) for start in starts))


def control_loop(physics: MujocoPhysics, env: Any) -> ControlLoop:
    """Return the control steps of robosuite 1.4: goals are in the world, a gripper's command moves on.

    robosuite 1.4 computes MuJoCo's forward dynamics three times in a physics step, twice to no effect.
    """
    robot = env.robots[0]

    def set_goal(controller: Any, action: FloatArray, steps: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        controller.set_goal(action[: controller.control_dim])
        gripper, command = robot.gripper, action[controller.control_dim :]
        before, commands = gripper.current_action, [gripper.format_action(command)]
        moves = not np.array_equal(before, commands[0])  # Else it is at its end, or is not told to.
        commands += [gripper.format_action(command) if moves else commands[0] for _ in range(steps - 1)]
        return controller.goal_pos, controller.goal_ori, np.array(commands)

    actuators = robot._ref_joint_actuator_indexes, robot._ref_joint_gripper_actuator_indexes
    tool = "eef_name", "ee_pos", "ee_ori_mat"
    return ControlLoop(physics, env, Version(lambda: robot.controller, tool, actuators, set_goal))


def fixtures_of(env: Any) -> tuple[dict[str, Any], dict[str, Any], Any]:
    """Return bodies and joints of an environment's fixtures by name, and the object or place of its goal."""
    model, data = env.sim.model._model, env.sim.data._data
    poses: dict[str, Any] = {}
    bodies = [model.body(number).name for number in range(model.nbody)]
    for fixture in env.fixtures_dict:
        poses |= {name.removesuffix("_main"): data.body(name) for name in bodies if name.startswith(f"{fixture}_")}
    starts = tuple(f"{fixture}_" for fixture in env.fixtures_dict)
    joints = [model.joint(number).name for number in range(model.njnt)]
    angles = {name: data.joint(name) for name in joints if name.startswith(starts)}
    goal = env.parsed_problem["goal_state"][0][-1]
    return poses, angles, data.site(goal) if goal in env.object_sites_dict else data.body(f"{goal}_main")


def key_light(env: Any, physics: MujocoPhysics) -> MujocoLights:
    """Return the lights of a scene. The kitchen's key light is directional; others have a position in a corner."""
    types, directional = list(physics.model.light_type), physics.mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    if directional in types:
        return MujocoLights(physics, types.index(directional))
    lit = np.array(getattr(env, "workspace_offset", (0.0, 0.0, 0.0)), dtype=np.float64)
    return MujocoLights(physics, physics.model.light("light1").id, lit=lit)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed NumPy's global generator, which LIBERO uses, and restore it afterwards."""
    before = np.random.get_state()
    np.random.seed(seed % 2**32)
    try:
        yield
    finally:
        np.random.set_state(before)


def open_simulation(task: str, view: View) -> LiberoSimulation:
    """Open the task of that name, such as `goal-7-turn-on-stove`.

    Raises:
        SimulatorUnavailable: LIBERO, a dependency or its assets are missing, or this machine cannot render.
    """
    return LiberoSimulation(import_libero(), libero_tasks()[task], view)
