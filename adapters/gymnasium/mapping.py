"""What the numbers of a gymnasium environment mean: a class for each task, which imports no gymnasium."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robogauntlet.adapters.contract import ActionSpec, FloatArray, Goal, Image
from robogauntlet.adapters.frames import relative_pose
from robogauntlet.suites.episode import CAMERAS


@dataclass(frozen=True, slots=True)
class Moment:
    """What an environment's latest `reset` or `step` returned."""

    world: Any
    """The environment without its wrappers, in its present state."""
    observation: Any
    info: Mapping[str, Any]
    reward: float = 0.0
    terminated: bool = False
    action: FloatArray | None = None
    """The environment's action, None after a reset."""


@dataclass(frozen=True, slots=True)
class Base:
    """The robot's base in an environment's world."""

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """In metres."""
    yaw: float = 0.0
    """About z (degrees)."""

    def point(self, position: ArrayLike) -> FloatArray:
        """Return a position of the world (3,), in metres, in the base frame."""
        turned = self._quaternion()
        return relative_pose(np.array(self.position), turned, np.asarray(position, np.float64), turned)[0]

    def direction(self, directions: ArrayLike) -> FloatArray:
        """Return directions of the world (n, 3) in the base frame."""
        from scipy.spatial.transform import Rotation

        turned: FloatArray = Rotation.from_quat(self._quaternion()).inv().apply(directions)
        return turned

    def orientation(self, matrix: ArrayLike, tool: tuple[float, float, float] | None = None) -> FloatArray:
        """Return a rotation of the world in the base frame, as a quaternion xyzw (4,).

        Args:
            matrix: The rotation, 9 numbers row by row, such as MuJoCo's `xmat`.
            tool: Turns a gripper's own frame so that z points out of it and its fingers open along y: intrinsic Euler
                angles xyz (degrees).
        """
        from scipy.spatial.transform import Rotation  # takes 0.2 s

        rotation = Rotation.from_matrix(np.reshape(matrix, (3, 3)))
        if tool is not None:
            rotation *= Rotation.from_euler("XYZ", tool, degrees=True)
        base = np.array(self.position)
        return relative_pose(base, self._quaternion(), base, rotation.as_quat())[1]

    def _quaternion(self) -> FloatArray:
        from scipy.spatial.transform import Rotation

        quaternion: FloatArray = Rotation.from_euler("z", self.yaw, degrees=True).as_quat()
        return quaternion


class EnvironmentMapping(ABC):
    """A task of a gymnasium environment: what its numbers mean.

    An episode ends where the environment returns `terminated`, or `truncated` by a limit of its own.
    """

    name: ClassVar[str]
    """Of the task, without its simulator."""
    env: ClassVar[str]
    """Id for `gymnasium.make`; `package:Id` imports the package that registers it."""
    make: ClassVar[Mapping[str, Any]] = {}
    """Further arguments of `gymnasium.make`."""
    instruction: ClassVar[str]
    horizon: ClassVar[int]
    """Control steps in which a competent policy succeeds comfortably."""
    action_spec: ClassVar[ActionSpec]
    """Bounds of an action, and the numbers without effect."""
    goal: ClassVar[Goal | None] = None
    """Without it, progress and the kinds of failures are not measured."""
    cameras: ClassVar[tuple[str, ...]] = CAMERAS[:1]

    def opened(self, world: Any) -> Any:
        """Return the environment without its wrappers, prepared once; MuJoCo's has `model` and `data` then."""
        return world

    @abstractmethod
    def observe(self, moment: Moment) -> dict[str, FloatArray]:
        """Return the privileged state by the contract's names, in the robot's base frame."""

    @abstractmethod
    def action(self, action: FloatArray) -> FloatArray:
        """Return the environment's action for one of the contract, as `action_spec` has it and within its bounds."""

    @abstractmethod
    def success(self, moment: Moment) -> bool:
        """Return whether the task is achieved."""

    def image(self, moment: Moment, size: int) -> Image:
        """Return the third-person image where the engine is not MuJoCo, (size, size, 3).

        By default what the environment's `render` draws, cropped to a square and scaled.
        """
        from PIL import Image as Pillow, ImageOps

        return np.array(ImageOps.fit(Pillow.fromarray(moment.world.render()), (size, size)))

    def camera(self, name: str, moment: Moment) -> Any:
        """Return one of `cameras`: in MuJoCo a name in the model, or an `MjvCamera` (see `orbit_camera`).

        Other environments are drawn by `image`, and are not asked.
        """
        raise NotImplementedError(f"{type(self).__name__}.camera: name a camera of MuJoCo's model for '{name}'")
