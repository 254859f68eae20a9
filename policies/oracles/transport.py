"""Scripted oracle of robosuite's TwoArmTransport, which passes the hammer as in TwoArmHandover."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import ARM_PREFIXES, FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, distance, pointing_down
from robogauntlet.policies.oracles.robosuite import UP, grasp, grasp_yaw, tool_yaw
from robogauntlet.policies.oracles.two_arms import PassHammer, grasp_bar, seen_by

XY = slice(0, 2)
THINGS = ("hammer", "trash", "lid", "start_bin", "target_bin", "trash_bin")


class Transport(PassHammer):
    """The first arm takes the lid off and passes the hammer, the second clears its bin and puts the hammer into it."""

    width = 0.03
    high = 0.17
    """Height of a tool above its base at which it and what it holds pass over the bins (m)."""
    lid_place = np.array([0.4, 0.25, 0.0])
    """Where the first arm brings the lid, in the frame of its base (m)."""
    handle, trash = 0.02, 0.04
    """Thickness of the lid's handle, and of the trash (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        first, second = (seen_by(arm, state, THINGS) for arm in ARM_PREFIXES)
        passing = np.split(self._pass(first, second), 2)
        return np.concatenate([self._open_bin(first, passing[0]), self._clear_bin(second, passing[1])])

    def _open_bin(self, own: State, then: FloatArray) -> FloatArray:
        place = own["lid_position"] + 0.005 * UP
        held = self._has(own, place, self.handle)
        if _apart(own, "lid", "start_bin") > 0.3:
            return self._to(own, own["tcp_position"], OPEN, tool_yaw(own)) if held else then
        if held:
            return self._carry(own, self.lid_place - own["lid_position"])
        turned = abs(tool_yaw(own))
        return self._from_above(own, place, 0.0, grasp_bar(own, place, pointing_down(0.0), turned, self.handle))

    def _clear_bin(self, own: State, then: FloatArray) -> FloatArray:
        offset, place = own["trash_bin_position"] - own["trash_position"], own["trash_position"]
        if _apart(own, "trash", "trash_bin") < 0.13 and offset[2] > 0.0:
            return then
        if self._has(own, place, self.trash):
            if _apart(own, "trash", "trash_bin") < 0.04:
                return self._to(own, own["tcp_position"], OPEN, tool_yaw(own))
            return self._carry(own, offset)
        yaw = grasp_yaw(own, "trash")
        return self._from_above(own, place, yaw, grasp(own, "trash", yaw))

    def _pass(self, first: State, second: State) -> FloatArray:
        """Pass the hammer and put it into the bin; the second arm waits until the first holds it out."""
        ends = [-Rotation.from_quat(own["hammer_quaternion"]).apply(UP) for own in (first, second)]
        near, far = (
            own["hammer_position"] + grip * way
            for own, grip, way in zip((first, second), self.grips, ends, strict=True)
        )
        end, tail = (float(np.arctan2(way[1], way[0])) for way in ends)
        waiting = self._to(second, self.aside, OPEN, 0.0)
        if self._holds(second, far):
            if distance(first, near) < 0.08 and float(first["finger_positions"].sum()) < self.width + 0.03:
                letting_go = self._to(first, first["tcp_position"], OPEN, tool_yaw(first))
                return np.concatenate([letting_go, self._to(second, second["tcp_position"], CLOSED, _across(tail))])
            leaving = first["tcp_position"] + 0.05 * UP if distance(first, near) < 0.15 else self.aside
            return np.concatenate([self._to(first, leaving, OPEN, tool_yaw(first)), self._put(second)])
        now, yaw = self._in_range(tool_yaw(first)), self._in_range(end)
        if not self._holds(first, near):
            turned = self._towards(float(np.clip(yaw, *self.yaws)), now)
            taking = self._grasp(first, near, turned, abs(yaw - now))
            return np.concatenate([self._from_above(first, near, turned, taking), waiting])
        tool = first["tcp_position"]
        if tool[2] < self.high - 0.06 and tool[0] < 0.6:  # Up before across.
            return np.concatenate([self._to(first, np.array([*tool[XY], self.high]), CLOSED, now), waiting])
        turned = self._towards(float(np.clip(self._in_range(now - yaw), *self.yaws)), now)
        holding = self._to(first, self.meeting, CLOSED, turned)
        if abs(yaw) > 0.1 or distance(first, self.meeting) > 0.015:
            return np.concatenate([holding, waiting])
        line = _across(tail)
        to_turn = abs((line - tool_yaw(second) + np.pi / 2) % np.pi - np.pi / 2)
        return np.concatenate([holding, self._grasp(second, far, line, to_turn)])

    def _put(self, own: State) -> FloatArray:
        """Lower the hammer into the bin that was cleared, and let it go."""
        offset, tool = own["target_bin_position"] - own["hammer_position"], own["tcp_position"]
        if _apart(own, "hammer", "target_bin") > 0.03:
            return self._carry(own, offset)
        is_low = -offset[2] < 0.13
        return self._to(own, tool if is_low else tool - 0.05 * UP, OPEN if is_low else CLOSED, tool_yaw(own))

    def _carry(self, own: State, offset: FloatArray) -> FloatArray:
        """Move what is held by an offset, over the bins: up before across."""
        tool = own["tcp_position"]
        across = tool if tool[2] < self.high - 0.03 else tool + offset
        return self._to(own, np.array([*across[XY], self.high]), CLOSED, tool_yaw(own))

    def _from_above(self, own: State, place: FloatArray, yaw: float, near: FloatArray) -> FloatArray:
        """Return the action to use near a place, or one that brings the tool there, over the bins."""
        tool = own["tcp_position"]
        if np.linalg.norm((place - tool)[XY]) <= 0.06:
            return near
        is_low = tool[2] < self.high - 0.06
        across = tool if is_low else place
        return self._to(own, np.array([*across[XY], self.high]), OPEN, tool_yaw(own) if is_low else yaw)

    @staticmethod
    def _has(own: State, place: FloatArray, width: float) -> bool:
        return distance(own, place) < 0.025 and abs(float(own["finger_positions"].sum()) - width) < 0.006


def _apart(own: State, thing: str, other: str) -> float:
    return float(np.linalg.norm((own[f"{thing}_position"] - own[f"{other}_position"])[XY]))


def _across(way: float) -> float:
    return float(way + np.pi / 2) % np.pi - np.pi / 2


SCRIPTS: Mapping[str, Callable[[], Script]] = {"robosuite/TwoArmTransport@TwoPandas": Transport}
