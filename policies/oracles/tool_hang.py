"""Scripted oracle of robosuite's ToolHang. It depends on the state alone, so it recovers from disturbances."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, distance, pointing_down
from robogauntlet.policies.oracles.robosuite import GAIN, UP, go, grasp_at, gripped, opened, tool_yaw

XY = slice(0, 2)
ALONG = np.array([1.0, 0.0, 0.0])
ASIDE = -0.5
"""Direction about the vertical (rad) to which the gripper points while it is tilted up, or the wrist would flip."""
FORWARDS = -0.14
"""The same at the stand: ahead is out of the wrist's reach there, and the stand's hole has as much play."""
UPRIGHT = Rotation.from_euler("z", -np.pi / 2)
"""The frame, upright, in a gripper's grasp that points along x."""
HIGH = 0.22
"""Height of a tool above its base from which it and what it holds pass over the stand (m)."""


class ToolHang:
    """Stands the frame in the stand's hole, lays the wrench's ring around the hook's end, tilts it, and lets go."""

    grip, tip, end = np.array([[0.04375, 0.0, 0.0525], [0.04375, 0.0, -0.1345], [-0.0437, 0.0, 0.0825]])
    """Places of the frame's grip, of its tip, and of its hook's end, in the frame (m)."""
    ring = np.array([-0.0965, 0.0, 0.0])
    """Middle of the ring, in the wrench (m)."""
    hole = np.array([0.0, 0.045, 0.08])
    """Where the frame is put in, in the stand (m)."""
    thick, wide = 0.0254, 0.03
    """Of the frame and of the wrench where they are grasped (m)."""
    tilted = 0.9
    """Angle at which the wrench is let go, as its ring then turns around the hook by its weight (rad)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        turn = Rotation.from_quat(state["frame_quaternion"])
        grip, tip, end = (state["frame_position"] + turn.apply(part) for part in (self.grip, self.tip, self.end))
        hole = state["stand_position"] + self.hole
        if hole[2] - tip[2] < 0.14 or np.linalg.norm((tip - hole)[XY]) > 0.01:
            return self._stand(state, turn, grip, tip, hole)
        if distance(state, grip) < 0.065 and _pointing(state)[2] > -0.8:
            away = 0.05 * _pointing(state) if opened(state, self.thick) else 0.0
            return go(state, state["tcp_position"] - away, OPEN, _tool(state))
        return self._hang(state, end, -turn.apply(ALONG))

    def _stand(self, state: State, turn: Rotation, grip: FloatArray, tip: FloatArray, hole: FloatArray) -> FloatArray:
        """Grasp the frame, which lies on the table, turn it, tilt it up, and lower it into the hole."""
        tcp, axis = state["tcp_position"], turn.apply(UP)
        way, yaw = float(np.arctan2(axis[1], axis[0])), tool_yaw(state)
        if not gripped(state, grip, self.thick):
            return grasp_at(state, grip, float(np.arctan2(-axis[1], -axis[0])), self.thick)
        if axis[2] < 0.36 and tcp[2] < 0.15:
            return go(state, np.array([*tcp[XY], 0.25]), CLOSED, pointing_down(yaw))
        if axis[2] < 0.36 and abs(way - ASIDE) > 0.2:
            turned = yaw - float(np.clip(way - ASIDE, -1.0, 1.0))
            return go(state, np.array([0.42, -0.15, 0.25]), CLOSED, pointing_down(turned))
        upright = Rotation.from_euler("z", FORWARDS if axis[2] > 0.99 else ASIDE) * UPRIGHT
        off = float((upright * turn.inv()).magnitude())
        rotation, below = upright * turn.inv() * _tool(state), hole[2] - tip[2]
        if below < 0.0 and off > (0.06 if tcp[2] < 0.2 else 0.3):
            return go(state, np.array([0.42, -0.1, 0.3]), CLOSED, rotation)
        offset = hole - tip
        aside = float(np.linalg.norm(offset[XY]))
        if below > 0.0 or (below > -0.015 and aside < 0.0035 and off < 0.1):
            offset -= axis * max(0.0, below) / axis[2]
            offset[2] = -0.02 if off < 0.07 else 0.01
        else:
            offset[2] += 0.005 + min(0.05, max(0.0, 3.0 * (aside - 0.008), 0.5 * (off - 0.08)))
        return go(state, tcp + offset, CLOSED, rotation)

    def _hang(self, state: State, end: FloatArray, outward: FloatArray) -> FloatArray:
        """Grasp the wrench, bring its ring to the hook's end from outside, tilt it there and let it go."""
        tcp, wrench = state["tcp_position"], state["wrench_position"]
        turn, yaw = Rotation.from_quat(state["wrench_quaternion"]), tool_yaw(state)
        handle = turn.apply(ALONG)
        way = float(np.arctan2(handle[1], handle[0]))
        if not gripped(state, wrench, self.wide):
            if _pointing(state)[2] > -0.8:
                return self._point_down(state)
            if distance(state, wrench, axes=XY) < 0.1:
                return grasp_at(state, wrench, way, self.wide)
            turned = pointing_down(yaw + float(np.clip(way - yaw, -1.0, 1.0)))  # Not across +-180 degrees.
            is_far = tcp[1] > -0.1 or abs(way - yaw) > 0.8
            place = np.array([0.42, -0.2, 0.25]) if is_far else np.array([*wrench[XY], 0.1])
            return go(state, place, OPEN, turned)
        offset = end - wrench - turn.apply(self.ring)
        aside = float(np.linalg.norm(offset[XY]))
        if aside < 0.012 and offset[2] > -0.022:
            return self._tilt(state, offset, float(np.arcsin(np.clip(-handle[2], -1.0, 1.0))), outward)
        to_turn = float(np.arctan2(outward[1], outward[0])) - way
        turned = pointing_down(yaw + float(np.clip(to_turn, -0.5, 0.5)))
        if abs(to_turn) < 0.05 and aside < 0.1:
            above = 0.014 + min(0.05, max(0.0, 8.0 * (aside - 0.0015)))
            return go(state, tcp + offset + above * UP, CLOSED, turned)
        across = tcp + offset if abs(to_turn) < 0.05 else np.array([0.45, 0.05, 0.0])
        return go(state, np.array([*(across if tcp[2] > HIGH - 0.02 else tcp)[XY], 0.32]), CLOSED, turned)

    def _tilt(self, state: State, offset: FloatArray, tilt: float, outward: FloatArray) -> FloatArray:
        """Lower the handle about the ring, which goes down and towards the frame."""
        tcp, share = state["tcp_position"], tilt / 1.05
        if tilt > self.tilted:
            return go(state, tcp, OPEN, _tool(state))
        turn = Rotation.from_rotvec(min(0.1, 1.05 - tilt) * np.cross(UP, outward))
        wrench = Rotation.from_quat(state["wrench_quaternion"])
        to_tool = tcp - state["wrench_position"] - wrench.apply(self.ring)
        offset = offset + (0.014 - 0.005 * share) * UP - 0.001 * share * outward
        return go(state, tcp + offset + (turn.apply(to_tool) - to_tool) / GAIN, CLOSED, turn * _tool(state))

    @staticmethod
    def _point_down(state: State) -> FloatArray:
        """Go up and point down again, back along the way on which the frame was tilted up."""
        tcp, tool = state["tcp_position"], _tool(state)
        place = np.array([0.42, -0.1, 0.32])
        if tcp[2] < HIGH and _pointing(state)[2] > -0.5:
            forwards = Rotation.from_euler("z", ASIDE) * Rotation.from_euler("y", np.pi / 2)
            return go(state, np.array([*tcp[XY], place[2]]), OPEN, forwards)
        across = tool.apply([0.0, 1.0, 0.0]) * [1.0, 1.0, 0.0]
        across /= np.linalg.norm(across)
        return go(state, place, OPEN, Rotation.from_matrix(np.column_stack([np.cross(across, -UP), across, -UP])))


def _tool(state: State) -> Rotation:
    return Rotation.from_quat(state["tcp_quaternion"])


def _pointing(state: State) -> FloatArray:
    pointing: FloatArray = _tool(state).apply(UP)
    return pointing


SCRIPTS: Mapping[str, Callable[[], Script]] = {"robosuite/ToolHang": ToolHang}
