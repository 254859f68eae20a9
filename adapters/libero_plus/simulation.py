"""LIBERO-Plus (arXiv 2510.13626): LIBERO's tasks of four suites under 10,030 variants of seven axes.

**What a seed means.** As in `robogauntlet.adapters.libero`: seed s starts from stored state s modulo 50, with fixtures
placed by s. LIBERO-Plus plays each variant once, from stored state 0: seed 0. A variant of the layout has one stored
state of its own, from which all seeds start.

**What a variant changes**, apart from LIBERO's own task:

- `camera`: the pose of the third-person camera. In all variants it is rounded to a tenth of a millimetre.
- `robot`: the posture of the arm at the reset, which the controller takes. The stored state sets the joints themselves
  afterwards, in LIBERO-Plus's code as here: the arm is where it always is, the controller pulls it away while objects
  come to rest, and `delivered` says how far.
- `language`: the instruction, from the task file.
- `light`, `background`: the scene and the textures of floor and wall.
- `noise`: the third-person images, at 256 px and then scaled to the size that is asked for.
- `layout`: positions of objects, and further objects.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from PIL import Image as PillowImage

from robogauntlet.adapters.contract import Delivered, FloatArray, Image, Observation, StepOutcome, TaskUnavailable
from robogauntlet.adapters.libero.assets import LIBERO_PLUS
from robogauntlet.adapters.libero.simulation import LiberoSimulation
from robogauntlet.adapters.libero_plus.image_noise import SIZE, noisy
from robogauntlet.adapters.libero_plus.package import VariantFiles, missing_objects, open_files
from robogauntlet.adapters.libero_plus.placement import camera_pose, posture, turn_between
from robogauntlet.adapters.libero_plus.variants import PlusAxis, variant
from robogauntlet.adapters.mujoco_parts.cameras import CAMERA_NAMES
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.adapters.user_assets import variable
from robogauntlet.suites.episode import View
from robogauntlet.support.errors import first_line


class LiberoPlusSimulation(LiberoSimulation):
    """One variant of a task, see `robogauntlet.adapters.contract.Simulation`."""

    def __init__(self, files: VariantFiles, view: View) -> None:
        """Build LIBERO's task from the variant's files, then move its camera and its arm's posture."""
        self.variant, self._variant_files = files.variant, files
        self._episode, self._drawn_noise = (0, 0), 0.0
        self._first_noise: float | None = None
        super().__init__(files, files.variant.base, view)
        self.instruction = files.variant.instruction
        self.scene_controls = SceneControls()
        seen = self._model.camera(CAMERA_NAMES["third_person"])
        self._own_camera = seen.pos.copy(), seen.quat.copy()
        seen.pos[:], seen.quat[:] = camera_pose(*self._own_camera, files.variant.view)
        robot = self._env.robots[0]
        robot.init_qpos = posture(np.array(robot.init_qpos), files.variant.start)

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, see `LiberoSimulation.reset`."""
        super().reset(seed)
        self._episode, self._first_noise = (seed, 0), None

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` for one control step. Never renders."""
        seed, steps = self._episode
        self._episode = seed, steps + 1
        return super().step(action)

    def observe(self) -> Observation:
        """Render the cameras of the view and read the arm."""
        observation = super().observe()
        if self._first_noise is None and "third_person" in observation.images and self.variant.noise:
            self._first_noise = self._drawn_noise
        return observation

    def draw(self, camera: str, size: int) -> Image:
        """Render the present state, (size, size, 3); noise depends on variant, seed and step alone."""
        if camera != "third_person" or not self.variant.noise:
            return super().draw(camera, size)
        clean = super().draw(camera, SIZE)
        generator = np.random.default_rng([self.variant.noise, *self._episode])
        image = noisy(clean[::-1], self.variant.noise, generator)[::-1]
        self._drawn_noise = psnr(image, clean)
        if size == SIZE:
            return image
        return np.array(PillowImage.fromarray(image).resize((size, size), PillowImage.Resampling.LANCZOS))

    def delivered(self) -> Delivered:
        """What the variant changed in this episode.

        `camera`: angle between both orientations (deg), distance moved, position in the world (m). `robot`: distance
        that the tool was pulled away before the episode began (cm), length of the posture's offset (rad). `language`:
        1 if the words differ. `noise`: PSNR of the first noisy image (dB), None without one. `layout`: the largest
        distance of one of LIBERO's objects from its nearest place in its stored states (cm). `light`: the lamps.
        """
        match self.variant.axis:
            case PlusAxis.CAMERA:
                seen = self._model.camera(CAMERA_NAMES["third_person"])
                position, quaternion = self._own_camera
                place = dict(zip(("x", "y", "z"), seen.pos.tolist(), strict=True))
                moved = float(np.linalg.norm(seen.pos - position))
                return Delivered(turn_between(quaternion, seen.quat), {"moved_m": moved, **place})
            case PlusAxis.ROBOT:
                return Delivered(self._tool_moved, {"posture_rad": self._posture_offset()})
            case PlusAxis.LANGUAGE:
                return Delivered(float(self.instruction != self.variant.base.instruction))
            case PlusAxis.NOISE:
                return Delivered(self._first_noise)
            case PlusAxis.LAYOUT:
                return Delivered(100.0 * self._largest_move())
            case PlusAxis.LIGHT:
                return Delivered(None, self._lamps())
        return Delivered(None)

    def _posture_offset(self) -> float:
        return float(np.linalg.norm(self._env.robots[0].init_qpos - self._env.robots[0].robot_model.init_qpos))

    def _come_to_rest(self, start: str) -> None:
        before = self.arm_state()["tcp_position"]
        super()._come_to_rest(start)
        self._tool_moved = 100.0 * float(np.linalg.norm(self.arm_state()["tcp_position"] - before))

    def _largest_move(self) -> float:
        """Return the largest distance of an object from the nearest of its places in LIBERO's own states (m)."""
        own = self._variant_files.own_states()
        added = {f"{kind}_" for kind in missing_objects(self.variant)}  # after LIBERO's own in the states
        moved = [one for name, one in self._objects.items() if name.rstrip("0123456789") not in added]
        joints = [self._model.body_jntadr[movable.body.id] for movable in moved]
        starts = [1 + int(self._model.jnt_qposadr[joint]) for joint in joints]
        places = [(own[:, start : start + 3], self._states[0, start : start + 3]) for start in starts]
        return max(float(np.linalg.norm(before - now, axis=1).min()) for before, now in places)

    def _lamps(self) -> Mapping[str, float]:
        model = self._model
        found: dict[str, float] = {}
        for number in range(model.nlight):
            name = model.light(number).name or str(number)
            found |= {f"{name}_diffuse_{c}": float(v) for c, v in zip("rgb", model.light_diffuse[number], strict=True)}
            found |= {f"{name}_direction_{c}": float(v) for c, v in zip("xyz", model.light_dir[number], strict=True)}
        return found


def psnr(image: Image, clean: Image) -> float:
    """Return the peak signal-to-noise ratio of an image (dB)."""
    error = float(np.mean((image.astype(np.float64) - clean) ** 2))
    return 10.0 * float(np.log10(255.0**2 / error)) if error else float("inf")


def open_simulation(task: str, view: View) -> LiberoPlusSimulation:
    """Open the task of that name, such as `robot-goal-7-448`.

    Raises:
        SimulatorUnavailable: LIBERO, a dependency or its assets are missing, or this machine cannot render.
        TaskUnavailable: LIBERO-Plus's files for this task are missing.
    """
    files = open_files(variant(task))
    try:
        return LiberoPlusSimulation(files, view)
    except (OSError, ValueError) as error:  # MuJoCo raises the latter for files that a model names
        if "No such file" not in str(error):
            raise
        raise TaskUnavailable(
            f"{files.assets.folder} lacks files in part ({first_line(error)}); see {variable(LIBERO_PLUS)}"
        ) from error
