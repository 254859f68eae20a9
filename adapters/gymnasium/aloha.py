"""ALOHA's cube transfer and insertion of gym-aloha: two ViperX arms face each other, seen from above.

- The first arm is the left one. Targets of joints are not limited in a step, as the environment does not.
- The camera is `top`, its square as wide as the environment's own picture of 640 x 480, which is its middle.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from robogauntlet.adapters.contract import ARM_PREFIXES, ActionSpec, FloatArray, Joint
from robogauntlet.adapters.gymnasium.mapping import Base, EnvironmentMapping, Moment

LIMITS = {
    "waist": (-3.14158, 3.14158),
    "shoulder": (-1.85005, 1.25664),
    "elbow": (-1.76278, 1.6057),
    "forearm_roll": (-3.14158, 3.14158),
    "wrist_angle": (-1.8675, 2.23402),
    "wrist_rotate": (-3.14158, 3.14158),
}
"""Least and greatest target of each joint (rad)."""
JOINTS = tuple(Joint(name, low, high, high - low) for name, (low, high) in LIMITS.items())
ARMS = {"left": Base((-0.469, 0.5, 0.0)), "right": Base((0.469, 0.5, 0.0), 180.0)}
FINGERS_MEET = 0.0224
"""Position of a finger's joint at which it meets the other (m)."""
TO_TOOL = 0.14
"""From the gripper's frame to the middle of the fingertips, along its x (m)."""
ASPECT = 640 / 480


class AlohaTransferCube(EnvironmentMapping):
    """The right arm lifts the cube, and the left one takes it: the left finger touches it, and the table does not."""

    name = "AlohaTransferCube-v0"
    env = "gym_aloha:gym_aloha/AlohaTransferCube-v0"
    make: ClassVar = {"obs_type": "pixels_agent_pos", "observation_width": 1, "observation_height": 1}
    instruction = "lift the red cube with the right arm and hand it over to the left arm"
    horizon = 400
    action_spec = ActionSpec(0.0, 0.0, 50.0, arms=2, joints=JOINTS)
    objects: ClassVar = {"cube": "box"}
    """Name of an object to that of its body."""

    def opened(self, world: Any) -> Any:
        """Show where MuJoCo's model and data are, keep steps from drawing three pictures each, and widen the camera."""
        physics, task = world._env.physics, world._env.task
        world.model, world.data = physics.model.ptr, physics.data.ptr
        images = {"top": np.zeros((1, 1, 3), np.uint8)}
        task.get_observation = lambda physics: {"qpos": task.get_qpos(physics), "images": images}
        top = world.model.camera("top")
        top.fovy[:] = 2.0 * math.degrees(math.atan(ASPECT * math.tan(math.radians(top.fovy[0]) / 2.0)))
        return world

    def observe(self, moment: Moment) -> dict[str, FloatArray]:
        """Return arms and objects."""
        data, first, second = moment.world.data, *ARMS.values()
        state = {
            "second_base_position": first.point(second.position),
            "second_base_quaternion": first.orientation(np.diag([-1.0, -1.0, 1.0])),
        }
        for number, (arm, (side, base)) in enumerate(zip(ARM_PREFIXES, ARMS.items(), strict=True)):
            own = self._arm(moment, side, base, slice(8 * number, 8 * number + len(JOINTS)))
            angles = np.split(moment.observation["agent_pos"], len(ARMS))[number]
            own |= {"joint_angles": angles[:-1], "gripper": 1.0 - 2.0 * angles[-1:]}
            state |= {arm + name: value for name, value in own.items()}
        for name, body in self.objects.items():
            pose = data.body(body)
            state |= {f"{name}_position": first.point(pose.xpos), f"{name}_quaternion": first.orientation(pose.xmat)}
        return state

    def _arm(self, moment: Moment, side: str, base: Base, joints: slice) -> dict[str, FloatArray]:
        """Return tool, fingers, targets and Jacobian of an arm, whose joints and servos these are."""
        import mujoco

        model, data = moment.world.model, moment.world.data
        hand = data.body(f"vx300s_{side}/gripper_link")
        tool, parts = hand.xpos + TO_TOOL * hand.xmat[::3], np.zeros((2, 3, model.nv))
        mujoco.mj_jac(model, data, *parts, tool, hand.id)
        fingers = [abs(float(data.joint(f"vx300s_{side}/{one}_finger").qpos[0])) for one in ("left", "right")]
        return {
            "tcp_position": base.point(tool),
            "tcp_quaternion": base.orientation(hand.xmat, tool=(0, 90, 180)),
            "finger_positions": np.maximum(0.0, np.array(fingers) - FINGERS_MEET),
            "joint_targets": np.array(data.ctrl[joints]),
            "tcp_jacobian": np.concatenate([base.direction(part[:, joints].T).T for part in parts]),
        }

    def action(self, action: FloatArray) -> FloatArray:
        """Return it with grippers from 0, closed, to 1, open."""
        arms = action.reshape(len(ARMS), -1).copy()
        arms[:, -1] = (1.0 - arms[:, -1]) / 2.0
        return arms.ravel()

    def success(self, moment: Moment) -> bool:
        """Return what the environment says: its reward is 4."""
        return bool(moment.info["is_success"])

    def camera(self, name: str, moment: Moment) -> Any:
        """Return the environment's camera for policies."""
        return "top"


class AlohaInsertion(AlohaTransferCube):
    """The right arm takes the peg and the left one the socket, and the peg touches the pin in the socket."""

    name = "AlohaInsertion-v0"
    env = "gym_aloha:gym_aloha/AlohaInsertion-v0"
    instruction = "lift the red peg and the blue socket and push the peg into the socket"
    objects: ClassVar = {"peg": "peg", "socket": "socket"}
