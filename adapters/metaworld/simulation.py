"""Meta-World (MuJoCo): a Sawyer at a table with fifty tasks. Its world has y forward, so poses are rotated.

- A soft weld pulls the hand to a mocap body. An action moves that body, within the box that the task allows, and in
  steady motion the tool covers about 0.9 of it. Rotations are ignored: the gripper keeps pointing down, and its fingers
  open along the base's x (the tool's y). The gripper's number is a force: close to zero, the gripper holds still.
- Object and goal are drawn from each seed, as in the benchmark's MT50 and ML45. The goal is not in proprioception; if
  the task has a marker for it, images show it, as Meta-World's own do.
- `third_person` is the camera `corner2`, moved closer (to where 3.1 has `corner4`). It is mounted upside down, so its
  images are rotated. `wrist` is `gripperPOV`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import ActionSpec, FloatArray, Image, Motion, SimulatorUnavailable, StepOutcome
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.metaworld.tasks import HANDLES, TASKS
from robogauntlet.adapters.mujoco_parts.contacts import MujocoContacts
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.mujoco_scene import MujocoScene, drawing_device, engine_time, import_mujoco, mujoco_state
from robogauntlet.suites.episode import View

CAMERAS = {"third_person": "corner2", "wrist": "gripperPOV"}
NEARBY = (0.75, 0.075, 0.7)
"""Position of the third-person camera in Meta-World's world (m)."""
BASE = Rotation.from_euler("z", 90, degrees=True)
"""The base frame in Meta-World's world. Both have their origin in the robot's base."""
TOOL = Rotation.from_euler("y", 90, degrees=True)
"""The tool's frame in the hand's, whose x points from wrist to fingertips."""
CLOSED = np.array([0.04, -0.03])
"""Joint positions of the right and the left finger at which they meet (m)."""

FINGERS = ("r_close", "l_close")
SURROUNDINGS = {"world", "tablelink", "RetainingWall", "wall", ""}
"""Bodies of the model beside the robot that are no objects of a task: floor, table and its edge, obstacle, and the
unnamed block with the hole of pick-out-of-hole."""


class MetaWorldSimulation(BaseSimulation):
    """One task of Meta-World, see `robogauntlet.adapters.contract.Simulation`."""

    culling = True

    def __init__(self, task: str, view: View) -> None:
        """Build the task's model.

        Raises:
            SimulatorUnavailable: Meta-World or MuJoCo is missing.
        """
        self._mujoco = import_mujoco()
        try:
            from metaworld.env_dict import ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE as ENVIRONMENTS
        except ImportError as error:
            raise SimulatorUnavailable(f'{error}; install it: pip install "robogauntlet[metaworld]"') from error
        self._env = ENVIRONMENTS[f"{task}-goal-observable"](seed=0)
        self._env._freeze_rand_vec, self._env.seeded_rand_vec = False, True  # Each reset draws, from its own seed.
        self._env.max_path_length = sys.maxsize  # The horizon is ours.
        self._model, self._data = self._env.model, self._env.data
        self._model.camera("corner2").pos = NEARBY
        physics = MujocoPhysics(self._mujoco, self._model, self._data, "base")
        roots = {self._model.body(root).name for root in self._model.body_rootid}
        self._contacts = MujocoContacts(physics, ["base"], FINGERS, roots - SURROUNDINGS - {"base", "mocap"})
        self._handle = BASE.apply(HANDLES[task]) if task in HANDLES else None
        self._scene = MujocoScene(self._model, self._data, view.render_profile)
        spec = ActionSpec(self._env.action_scale, 0.0, control_hz=1.0 / self._env.dt, ignored=("rx", "ry", "rz"))
        super().__init__(view, TASKS[task].instruction, spec)

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, from which Meta-World draws object and goal.

        Meta-World leaves the poses of bodies that it has moved as they were before, until the first step.
        """
        self._env.seed(seed)
        self._env.reset()
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)
        self._mujoco.mj_camlight(self._model, self._data)

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` (7,) for one control step of five physics steps. The reward is Meta-World's, 0 to 10."""
        action = np.clip(action, self.action_spec.low, self.action_spec.high)
        command = np.append(BASE.apply(action[:3]) / self._env.action_scale, action[6])
        _, reward, _, _, info = self._env.step(command)
        return StepOutcome(reward=float(reward), success=bool(info["success"]))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return tool, fingers and `hand_position`, `goal_position`, `object_position`.

        Some tasks have `other_position` too, of a second object, or `handle_position`, of the place of `HANDLES`.
        """
        world, hand = BASE.inv(), self._data.body("hand")
        orientation = (world * Rotation.from_matrix(hand.xmat.reshape(3, 3)) * TOOL).as_quat()
        state = {"tcp_quaternion": orientation, "finger_positions": self._fingers()}
        return state | {name: world.apply(position) for name, position in self._positions().items()}

    def motion(self, entries: Sequence[str]) -> Motion:
        """Return tool and fingers, these positions, and contacts.

        Objects are all bodies except the robot and `SURROUNDINGS`, since Meta-World does not name those of a task.
        Joint limits are not measured: the weld pulls the hand, and the shoulder leans on its limit all the time.
        """
        positions, base = self._positions(), BASE.as_matrix()
        return Motion(
            tool=positions["tcp_position"] @ base,
            opening=float(self._fingers().sum()),
            entries=tuple(positions[entry] @ base for entry in entries),
            contact_force=self._contacts.contact_force(),
        )

    def _fingers(self) -> FloatArray:
        """Return how far each finger is from where they meet, (2,) (m)."""
        fingers = np.concatenate([self._data.joint(name).qpos for name in FINGERS])
        return np.asarray((CLOSED - fingers) * (1.0, -1.0))

    def _positions(self) -> dict[str, FloatArray]:
        """Return all positions of the privileged state, in Meta-World's world."""
        positions = {
            "tcp_position": self._env.tcp_center,
            "hand_position": self._data.body("hand").xpos,
            "goal_position": self._env._get_pos_goal(),
        }
        objects = self._env._get_pos_objects().reshape(-1, 3)
        positions |= dict(zip(("object_position", "other_position"), objects, strict=False))
        if self._handle is not None:
            positions["handle_position"] = objects[0] + self._handle
        return positions

    def state_hash(self) -> str:
        """Hash joints, mocap body, fixed bodies and goal."""
        return hash_state(mujoco_state(self._model, self._data) | {"goal": self._env._get_pos_goal()})

    def draw(self, camera: str, size: int) -> Image:
        """Render an upright image of a camera, (size, size, 3)."""
        image = self._scene.image(CAMERAS[camera], size, culling=self.culling)
        return image[::-1, ::-1].copy() if camera == "third_person" else image

    def render_device(self) -> str:
        """Return OpenGL's name of the renderer."""
        self.draw("third_person", self.view.image_size)
        return drawing_device()

    def close(self) -> None:
        """Free the renderers."""
        self._scene.close()

    def engine_time(self) -> float:
        """Return the CPU time of MuJoCo alone in a control step from the present state (s), which stays as it is."""
        return engine_time(self._model, self._data, self._env.frame_skip)
