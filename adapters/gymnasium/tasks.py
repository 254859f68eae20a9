"""The shipped tasks: Fetch of gymnasium-robotics (MuJoCo) reaches and picks, panda-gym's arm (PyBullet) reaches."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, FloatArray, Goal
from robogauntlet.adapters.gymnasium.mapping import Base, EnvironmentMapping, Moment
from robogauntlet.adapters.mujoco_scene import orbit_camera
from robogauntlet.suites.episode import CAMERAS

ROTATIONS = ("rx", "ry", "rz")


class FetchReach(EnvironmentMapping):
    """A closed gripper reaches a point.

    A mocap body is set 0.05 m from the hand at a full command, and the hand covers 65 % of that in a step, in every
    direction: 1 / 0.05 / 0.65 = 30.8 of a command for a metre.
    """

    name = "FetchReach-v4"
    env = "gymnasium_robotics:FetchReach-v4"
    instruction = "move the closed gripper to the red ball"
    horizon = 30
    action_spec = ActionSpec(0.03, 0.0, 25.0, (*ROTATIONS, "gripper"))
    goal = Goal("tcp_position", "goal_position", tolerance=0.05)
    cameras = CAMERAS
    base = Base((0.69, 0.744, 0.0))

    def observe(self, moment: Moment) -> dict[str, FloatArray]:
        """Return tool, fingers and goal."""
        data = moment.world.data
        hand = data.site("robot0:grip")
        return {
            "tcp_position": self.base.point(hand.xpos),
            "tcp_quaternion": self.base.orientation(hand.xmat, tool=(0, 90, 180)),
            "finger_positions": np.concatenate([data.joint(f"robot0:{s}_gripper_finger_joint").qpos for s in "rl"]),
            "goal_position": self.base.point(moment.observation["desired_goal"]),
        }

    def action(self, action: FloatArray) -> FloatArray:
        """Return the translation as shares of a full command, and the gripper at rest."""
        return np.append(30.8 * action[:3], 0.0)

    def success(self, moment: Moment) -> bool:
        """Return what the environment says."""
        return bool(moment.info["is_success"])

    def camera(self, name: str, moment: Moment) -> Any:
        """Return a camera of the model, or one that follows the hand."""
        if name == "wrist":
            return orbit_camera(moment.world.data.site("robot0:grip").xpos, 0.35, 0, -50)
        return "external_camera_0"


class FetchPickAndPlace(FetchReach):
    """The same arm carries a cube to a point."""

    name = "FetchPickAndPlace-v4"
    env = "gymnasium_robotics:FetchPickAndPlace-v4"
    instruction = "carry the black cube to the red ball"
    horizon = 100
    action_spec = ActionSpec(0.03, 0.0, 25.0, ROTATIONS)
    goal = Goal("cube_position", "goal_position", tolerance=0.05, grasped=True)

    def observe(self, moment: Moment) -> dict[str, FloatArray]:
        """Return the cube, too."""
        cube = moment.world.data.site("object0")
        pose = {"cube_position": self.base.point(cube.xpos), "cube_quaternion": self.base.orientation(cube.xmat)}
        return super().observe(moment) | pose

    def action(self, action: FloatArray) -> FloatArray:
        """Return the translation, and the gripper, which opens upwards."""
        return np.append(30.8 * action[:3], -action[6])


class PandaReach(EnvironmentMapping):
    """A closed gripper reaches a point, drawn by panda-gym's own `render`: there is no camera at the wrist.

    A full command is 0.05 m, of which the arm covers 55 to 90 % in steady motion, depending on the direction: with 28
    of a command for a metre it moves by 0.75 to 1.23 of what it is told.
    """

    name = "PandaReach-v3"
    env = "panda_gym:PandaReach-v3"
    make: ClassVar = {
        **{"render_mode": "rgb_array", "renderer": "Tiny", "render_width": 256, "render_height": 256},
        **{"render_distance": 1.0, "render_target_position": [-0.2, 0.0, 0.1]},
    }
    instruction = "reach the green ball with the closed gripper"
    horizon = 20
    action_spec = ActionSpec(0.03, 0.0, 25.0, (*ROTATIONS, "gripper"))
    goal = Goal("tcp_position", "goal_position", tolerance=0.05)
    base = Base((-0.6, 0.0, 0.0))

    def observe(self, moment: Moment) -> dict[str, FloatArray]:
        """Return tool and goal. The hand points down, and the fingers stay closed."""
        return {
            "tcp_position": self.base.point(moment.observation["achieved_goal"]),
            "tcp_quaternion": np.array([1.0, 0.0, 0.0, 0.0]),
            "finger_positions": np.zeros(2),
            "goal_position": self.base.point(moment.observation["desired_goal"]),
        }

    def action(self, action: FloatArray) -> FloatArray:
        """Return the translation as shares of a full command."""
        return 28.0 * action[:3]

    def success(self, moment: Moment) -> bool:
        """Return what the environment says."""
        return bool(moment.info["is_success"])


MAPPINGS = (FetchPickAndPlace, FetchReach, PandaReach)
