"""LIBERO (robosuite 1.4, MuJoCo): 130 tasks of a Panda at a table, with fifty stored initial states each.

**What a seed means.** Seed s starts from stored state s modulo 50. A stored state holds where the arm, the objects and
the joints of fixtures are, but not where the fixtures stand (cabinet, stove, microwave, rack): LIBERO draws that, up to
1.9 cm apart, from NumPy's global generator, which is seeded with s for as long as the reset takes. So seeds 50 and up
repeat the stored states with the fixtures elsewhere, and in tasks without fixtures repeat the episodes of 0 to 49.

What is particular here:

- After the stored state is set, ten control steps with the gripper opening let things come to rest, as LIBERO's and
  OpenVLA's evaluations do; more, up to `PATIENCE`, while something still moves, and beyond that the seed is refused.
- The controller is OSC_POSE with delta input: a spring between the tool and a goal that is set anew, from the pose
  achieved, in each control step. In steady motion the tool covers `REACHED` of the offset that it is given. The adapter
  gives it that much more, so that the tool moves by the action. LIBERO's own actions are shares of `action_spec.high`:
  an action of 1 is an offset of 5 cm and 0.5 rad, of which the tool moves 1.31 cm and 0.118 rad in a control step.
- Images are drawn here and not by robosuite 1.4, which never makes its OpenGL context current again and so draws the
  wrong world as soon as a process has had two. They are the same to the bit, but the right way up.
- Resets are soft. LIBERO's hard reset, its default, builds a new model each time, and appends a sampler of drawers and
  doors each time, which draws more numbers: the same seed is not the same world twice.
- A soft reset leaves what the gripper was told: it is told nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from adapters.adjusting import Adjusters
from adapters.contract import (
    ActionSpec,
    AdapterError,
    FloatArray,
    Simulator,
    SimulatorUnavailable,
    StepOutcome,
    UnsupportedCondition,
)
from adapters.libero.objects import LiberoObjects
from adapters.libero.package import Libero, open_libero, silenced
from adapters.libero.tasks import TABLES, LiberoTask, libero_tasks
from adapters.libero.things import thing_of
from adapters.mujoco_parts.arm import MujocoArm
from adapters.mujoco_parts.bodies import MujocoBodies
from adapters.mujoco_parts.cameras import MujocoCameras
from adapters.mujoco_parts.frame import BaseFrame
from adapters.mujoco_parts.lights import MujocoLights
from adapters.mujoco_parts.simulation import MujocoSimulation
from adapters.mujoco_parts.stage import MujocoStage
from suites.vocabulary import CLEAN, Condition, View

CONTROL_HZ = 20.0
REACHED = (0.262, 0.236)
"""Share of a translation and of a rotation that the tool covers in a control step of steady motion. Measured (along the
axes 25.4 to 26.9 % and 23.0 to 25.1 %). A spring that is critically damped gives s / (1 + s / 2) = 26.5 % with
s = sqrt(150) / 2 / 20; friction in the joints takes the rest."""
STORED_STATES = 50
"""Of each task."""
SETTLING = 10
"""Control steps after the stored state is set, before the episode begins."""
PATIENCE = 40
"""Control steps at which things must have come to rest."""
AT_REST = 0.05
"""What moves no faster than this is at rest (m/s)."""
STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])
PLACEMENTS = 100
"""How often LIBERO may find no room for its things before the reset is given up. It would try for ever."""


class LiberoSimulation(MujocoSimulation):
    """One task of LIBERO, see `adapters.contract.Simulation`."""

    def __init__(self, package: Libero, task: LiberoTask, view: View) -> None:
        """Build the model, a renderer for `view`, and take one step, on which numba compiles the controller.

        Raises:
            SimulatorUnavailable: Nothing here can render.
        """
        with silenced():
            self._env = package.environment(
                bddl_file_name=str(package.description(task.libero_suite, task.name)),
                control_freq=CONTROL_HZ,
                ignore_done=True,
                hard_reset=False,
                has_offscreen_renderer=False,
                use_camera_obs=False,
            ).env
        for name in self._env.observation_names:  # Updated 25 times a control step, and nobody reads them.
            self._env.modify_observable(name, "enabled", False)
        world = self._env.sim.model._model, self._env.sim.data._data
        super().__init__(package.mujoco, world, view, task.instruction)
        self._states = package.stored_states(task.libero_suite, task.name)
        if self._states.shape != (STORED_STATES, 1 + self._model.nq + self._model.nv):
            expected = f"({STORED_STATES}, {1 + self._model.nq + self._model.nv})"
            raise AdapterError(
                f"libero/{task.task}: expected stored states of shape {expected}, found {self._states.shape}: "
                "assets and package do not belong together"
            )

        robot = self._env.robots[0]
        limits = robot.controller.output_max
        self.action_spec = ActionSpec(
            max_translation=REACHED[0] * float(limits[0]),
            max_rotation=REACHED[1] * float(limits[3]),
            control_hz=CONTROL_HZ,
        )
        tool = robot.gripper.important_sites["grip_site"], robot.robot_model.eef_name
        self._take_arm(robot.robot_model.root_body, *tool, robot.gripper.joints)
        self._things = {name: thing_of(self._model, self._data, name) for name in self._env.objects_dict}
        self._poses_of, self._angles_of, self._goal = fixtures_of(self._env)
        frame = BaseFrame(self._base)
        arm = MujocoArm(package.mujoco, world, lambda: self._env.robots[0].controller, tool, frame, self._settle)
        self._lights = key_light(self._env, self._model, frame, package.mujoco)
        self._stage = MujocoStage(package.mujoco, world, frame, self._scene.renderers) if task.arena in TABLES else None
        movable = {name: self._things[name] for name in task.placeable}
        objects = LiberoObjects(world, movable, self._states, frame, self._settle) if movable else None
        bodies = [f"{thing}_main" for thing in task.things]
        self.adjusters = Adjusters(
            cameras=MujocoCameras(self._model, self._base),
            lights=self._lights,
            objects=objects,
            arm=arm,
            bodies=MujocoBodies(self._model, bodies, self._settle) if bodies else None,
            stage=self._stage,
        )
        self._assets = str(package.assets)
        self._task, self._closed, self._shift = task, False, 0.0
        self.reset(0, Condition())
        try:
            self.render_device()
        except SimulatorUnavailable:
            self.close()
            raise

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the episode of `seed`: stored state `seed` modulo 50, fixtures placed by `seed`, and settling.

        Raises:
            AdapterError: Something does not come to rest.
        """
        if condition.axis != CLEAN:
            raise UnsupportedCondition(f"libero cannot bring about {condition}: this adapter knows clean only")
        self._undo_adjustments()
        for robot in self._env.robots:
            robot.gripper.current_action = np.zeros(robot.gripper.dof)
        with seeded(seed):
            self._place()
        number = seed % STORED_STATES
        self._env.sim.set_state_from_flattened(self._states[number])
        self._env.sim.forward()
        self._env._check_success()  # As LIBERO's own `set_init_state` does: what is looked up here is drawn.
        self._env._post_process()
        self._come_to_rest(number)

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` for one control step (25 physics steps). Never renders."""
        spec = self.action_spec
        return self._step(np.clip(action, spec.low, spec.high) / spec.high)

    def _step(self, action: FloatArray) -> StepOutcome:
        _, reward, done, _ = self._env.step(action)
        return StepOutcome(reward=float(reward), success=bool(done))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """The true state: `tcp_*` and `finger_positions`, then what the task has, named as LIBERO names it.

        The middle of every object (`akita_black_bowl_1_*`), every body of a fixture
        (`wooden_cabinet_1_cabinet_top_*`), fixtures' joints (`wooden_cabinet_1_top_level`, (1,), m or rad), and
        `goal_position`, of what or where the first of the goal's predicates is about. `settling_shift` (1,) is how far
        an object moved sideways while things came to rest (m): a few of the stored states are bad.
        """
        state = self._arm_state() | self._poses(self._things | self._poses_of)
        state |= {name: joint.qpos.copy() for name, joint in self._angles_of.items()}
        state["goal_position"], _ = self._in_base(self._goal.xpos, self._goal.xmat)
        return state | {"settling_shift": np.array([self._shift])}

    def render_device(self) -> str:
        """OpenGL's name of what draws, and what it draws."""
        return f"{super().render_device()}, {self._assets}"

    def close(self) -> None:
        """Free the renderers and the model."""
        if self._closed:
            return
        self._closed = True
        self._scene.close()
        self._env.close()

    def _place(self) -> None:
        """LIBERO's own reset. What it places, the stored state then moves, but for the fixtures."""
        from robosuite.utils.errors import RandomizationError

        for _ in range(PLACEMENTS):
            try:
                self._env.reset()
            except RandomizationError:
                continue
            return
        raise AdapterError(f"libero/{self._task.task}: LIBERO found no room for its things in {PLACEMENTS} tries")

    def _come_to_rest(self, number: int) -> None:
        before = self._sites()
        for taken in range(PATIENCE):
            if taken >= SETTLING and self._fastest() <= AT_REST:
                break
            self._step(STILL)
        else:
            raise AdapterError(
                f"libero/{self._task.task}: stored state {number} does not come to rest within {PATIENCE} steps; "
                "leave this seed out"
            )
        self._shift = float(np.linalg.norm(self._sites() - before, axis=1).max())

    def _sites(self) -> FloatArray:
        """Where the free things are, x and y, (n, 2)."""
        self._refresh()
        return np.array([thing.body.xpos[:2] for thing in self._things.values()])

    def _fastest(self) -> float:
        """The largest speed of a free thing (m/s)."""
        starts = [self._model.body_dofadr[thing.body.id] for thing in self._things.values()]
        return float(max(np.linalg.norm(self._data.qvel[start : start + 3]) for start in starts))


def fixtures_of(env: Any) -> tuple[dict[str, Any], dict[str, Any], Any]:
    """Fixtures in MuJoCo's data: their bodies by name, their joints by name, and what or where the goal is about.

    Args:
        env: LIBERO's.
    """
    model, data = env.sim.model._model, env.sim.data._data
    poses: dict[str, Any] = {}
    named = [model.body(number).name for number in range(model.nbody)]
    for fixture in env.fixtures_dict:
        poses |= {name.removesuffix("_main"): data.body(name) for name in named if name.startswith(f"{fixture}_")}
    joints = [model.joint(number).name for number in range(model.njnt)]
    angles = {
        name: data.joint(name)
        for name in joints
        if any(name.startswith(f"{fixture}_") for fixture in env.fixtures_dict)
    }
    about = env.parsed_problem["goal_state"][0][-1]
    return poses, angles, data.site(about) if about in env.object_sites_dict else data.body(f"{about}_main")


def key_light(env: Any, model: Any, frame: BaseFrame, mujoco: Any) -> MujocoLights:
    """The lights of a scene. The kitchen has a lamp above all of it; other lamps stand at a corner of the room."""
    types = list(model.light_type)
    if mujoco.mjtLightType.mjLIGHT_DIRECTIONAL in types:
        return MujocoLights(model, frame, types.index(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL))
    lit = np.array(getattr(env, "workspace_offset", (0.0, 0.0, 0.0)), dtype=np.float64)
    return MujocoLights(model, frame, model.light("light1").id, lit=lit)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed NumPy's global generator, from which LIBERO draws, and put it back afterwards."""
    before = np.random.get_state()
    np.random.seed(seed % 2**32)
    try:
        yield
    finally:
        np.random.set_state(before)


def open_simulation(task: str, view: View) -> LiberoSimulation:
    """Open the task of that name, such as `goal-7-turn-on-stove`.

    Raises:
        SimulatorUnavailable: LIBERO, what it stands on or its assets are missing, or nothing here can render.
    """
    return LiberoSimulation(open_libero(), libero_tasks()[task], view)


SIMULATOR = Simulator(
    name="libero",
    title="LIBERO (robosuite 1.4, MuJoCo)",
    tasks={name: task.card for name, task in libero_tasks().items()},
    modules=("libero", "robosuite", "mujoco", "bddl"),
    distributions=("hf-libero", "robosuite", "mujoco", "numba"),
    open=open_simulation,
    adjusts=frozenset({"cameras", "lights", "objects", "arm", "bodies", "stage"}),
    environment={"MUJOCO_GL": "egl"},
    requirements=(
        "mujoco==3.3.7",
        "numpy==1.26.4",
        "numba>=0.60",
        "opencv-python==4.11.0.86",
        "gymnasium>=1.0",
        "matplotlib>=3.9",
        "cloudpickle>=3",
        "termcolor>=2",
        "easydict==1.14",
        "future==1.0.0",
    ),
    without_dependencies=("hf-libero==0.1.4", "robosuite==1.4.0", "bddl==1.0.1"),
)
