"""Scripted oracles of two arms. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import ARM_PREFIXES, FloatArray
from robogauntlet.policies.oracles.maniskill_motion import CUBE, go_turned, lean_at, leaning
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, distance, pointing_down, yaw_of
from robogauntlet.policies.oracles.robosuite import UP, go, scripts_of, tool_yaw


class TwoArmLift:
    """Grasps a handle of the pot with each arm, and lifts both together."""

    bar = 0.02
    """Thickness of a handle (m)."""
    farthest_turn = 1.75
    """Largest yaw of a gripper (rad), within the range of its last joint."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        handles = ("handle0", "handle1")
        arms = [seen_by(arm, state, handles) for arm in ARM_PREFIXES]
        held = [self._holds(own, handle) for own, handle in zip(arms, handles, strict=True)]
        heights = [state[f"{handle}_position"][2] for handle in handles]
        actions = []
        for own, handle, height in zip(arms, handles, heights, strict=True):
            rotation = pointing_down(self._yaw(own, handle))
            if all(held):
                # The lower side first, so that the pot stays level.
                rise = 0.05 - 4.0 * (height - min(heights))
                actions.append(go(own, own["tcp_position"] + rise * UP, CLOSED, rotation))
            else:
                to_turn = float((rotation * Rotation.from_quat(own["tcp_quaternion"]).inv()).magnitude())
                actions.append(grasp_bar(own, own[f"{handle}_position"], rotation, to_turn, self.bar))
        return np.concatenate(actions)

    def _yaw(self, own: State, handle: str) -> float:
        """The nearest yaw at which the fingers close across the handle."""
        now, yaw = tool_yaw(own), yaw_of(own[f"{handle}_quaternion"])
        possible = [y for k in range(-2, 3) if abs(y := yaw + k * np.pi) <= self.farthest_turn]
        return min(possible, key=lambda y: abs(y - now))

    def _holds(self, own: State, handle: str) -> bool:
        opening = float(own["finger_positions"].sum())
        return distance(own, own[f"{handle}_position"]) < 0.03 and 0.5 * self.bar < opening < 1.4 * self.bar


class PassHammer:
    """The first arm grasps the hammer by its handle, beside the head, and holds its end out to the second arm.

    Its last joint turns almost once around, so that the end can be held out however the hammer lies.
    """

    width = 0.036
    """Of the handle (m)."""
    grips = -0.045, 0.055
    """Where the first and the second arm grasp it, from its middle towards its end (m)."""
    meeting = np.array([0.76, 0.0, 0.12])
    """Where the first arm holds it out, in the frame of its base (m)."""
    aside = np.array([0.6, 0.0, 0.25])
    """Where the second arm waits, in the frame of its own (m)."""
    yaws = -2.0, 3.5
    """Range of the first hand's rotation about the vertical (rad)."""
    turn = 0.6
    """Largest rotation asked for at once (rad): a larger one could go the short way, beyond the joint's range."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        first, second = arms = [seen_by(arm, state, ("hammer",)) for arm in ARM_PREFIXES]
        ends = [-Rotation.from_quat(own["hammer_quaternion"]).apply(UP) for own in arms]
        places = [own["hammer_position"] + grip * end for own, grip, end in zip(arms, self.grips, ends, strict=True)]
        line = float(np.arctan2(ends[1][1], ends[1][0]) + np.pi / 2) % np.pi - np.pi / 2
        if self._holds(second, places[1]):
            let_go = float(first["finger_positions"].sum()) > self.width + 0.03
            retreat, lift = (0.05 * UP, 0.02 * UP) if let_go else (0.0, 0.0)
            leaving = self._to(first, first["tcp_position"] + retreat, OPEN, tool_yaw(first))
            return np.concatenate([leaving, self._to(second, second["tcp_position"] + lift, CLOSED, line)])
        waiting = self._to(second, self.aside, OPEN, 0.0)
        now, end = (self._in_range(angle) for angle in (tool_yaw(first), float(np.arctan2(ends[0][1], ends[0][0]))))
        if not self._holds(first, places[0]):
            yaw = float(np.clip(end, *self.yaws))
            return np.concatenate([self._grasp(first, places[0], self._towards(yaw, now), abs(yaw - now)), waiting])
        yaw = float(np.clip(self._in_range(now - end), *self.yaws))
        target, tool = self.meeting.copy(), first["tcp_position"]
        if tool[2] < 0.05:  # Up before across.
            target[:2] = tool[:2]
        holding = self._to(first, target, CLOSED, self._towards(yaw, now))
        if abs(end) > 0.1 or distance(first, self.meeting) > 0.015:
            return np.concatenate([holding, waiting])
        to_turn = abs((line - tool_yaw(second) + np.pi / 2) % np.pi - np.pi / 2)
        return np.concatenate([holding, self._grasp(second, places[1], line, to_turn)])

    def _in_range(self, angle: float) -> float:
        """Return an angle of the first hand (rad) without a jump within its range."""
        middle = sum(self.yaws) / 2
        return (angle - middle + np.pi) % (2 * np.pi) - np.pi + middle

    def _towards(self, yaw: float, now: float) -> float:
        return now + float(np.clip(yaw - now, -self.turn, self.turn))

    def _holds(self, own: State, place: FloatArray) -> bool:
        return distance(own, place) < 0.03 and abs(float(own["finger_positions"].sum()) - self.width) < 0.008

    def _grasp(self, own: State, place: FloatArray, yaw: float, to_turn: float) -> FloatArray:
        return grasp_bar(own, place, leaning(yaw, lean_at(own)), to_turn, self.width)

    @staticmethod
    def _to(own: State, target: FloatArray, gripper: float, yaw: float) -> FloatArray:
        return go(own, target, gripper, leaning(yaw, lean_at(own)))


class PegInHole:
    """Brings the plate between the arms, turns the peg across it, and pushes it through the hole."""

    meeting = np.array([0.58, -0.17, 0.12])
    """Where the second arm holds the hole (m)."""
    hole = np.array([0.1, 0.0, 0.0])
    """The middle of the hole in the frame of the plate, whose normal is z (m)."""
    to_middle = 0.13
    """From the tool to the middle of the peg (m)."""
    outside, inside, away = 0.22, 0.05, 0.18
    """Distances of the peg's middle from the hole before and after the push, and from which it is off the plate (m)."""
    aligned, centred = 0.15, 0.04
    """Angle to the plate's normal (rad) and distance from the hole's axis (m) with which the push begins."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        plate = Rotation.from_quat(state["plate_quaternion"])
        hole, normal = state["plate_position"] + plate.apply(self.hole), plate.apply(UP)
        normal *= -np.sign(normal[1])  # Away from the side on which the first arm waits.
        to_hole = hole - state["peg_position"]
        depth = float(to_hole @ normal)
        lateral = float(np.linalg.norm(to_hole - depth * normal))
        rotation = Rotation.from_quat(state["tcp_quaternion"])
        way = Rotation.from_quat(state["peg_quaternion"]).apply(UP)
        turn = Rotation.align_vectors(normal, way)[0]
        ready = lateral < self.centred and float(turn.magnitude()) < self.aligned
        tool = hole - ((self.inside if ready else self.outside) + self.to_middle) * normal
        if lateral >= self.centred and depth < self.away:
            tool = state["tcp_position"] - (self.outside - depth) * normal
        second = seen_by(ARM_PREFIXES[1], state, ())
        home = Rotation.from_quat(state["second_base_quaternion"]).inv()
        held = second["tcp_position"] + home.apply(self.meeting - hole)
        return np.concatenate([go(state, tool, OPEN, turn * rotation), go(second, held, OPEN, pointing_down(0.0))])


class _Cubes:
    """Two arms of ManiSkill with cubes between them."""

    aside = np.array([0.52, 0.0, 0.25])
    """Where an arm is out of the other's way, in the frame of its own base (m)."""
    clear = 0.63
    """Distance of a tool from its base below which it is out of the way (m)."""

    def _holds(self, own: State, cube: str) -> bool:
        opening = float(own["finger_positions"].sum())
        return distance(own, own[f"{cube}_position"]) < 0.025 and abs(opening - CUBE) < 0.006

    def _put(self, own: State, cube: str, place: FloatArray) -> FloatArray:
        """Carry the cube to a place, from a little above, and let it go there."""
        tool, offset = own["tcp_position"], place - own[f"{cube}_position"]
        if np.linalg.norm(offset[:2]) < 0.012 and abs(offset[2]) < 0.006:
            return self._to(own, tool, OPEN)
        offset[2] += min(0.04, 4.0 * max(0.0, float(np.linalg.norm(offset[:2])) - 0.01))
        return self._to(own, tool + offset, CLOSED)

    def _withdraw(self, own: State, cube: str) -> FloatArray:
        """Open the fingers, rise, and move back."""
        tool, place = own["tcp_position"], own[f"{cube}_position"]
        if float(own["finger_positions"].sum()) < CUBE + 0.02 and distance(own, place) < 0.05:
            return self._to(own, tool, OPEN)
        beside = distance(own, place, axes=slice(0, 2)) < 0.06
        rising = beside and tool[2] < place[2] + 0.1
        return self._to(own, np.array([*tool[:2], place[2] + 0.18]) if rising else self.aside, OPEN)

    def _grasp(self, own: State, cube: str) -> FloatArray:
        """Open, approach the cube from above within a funnel, close."""
        place, tool = own[f"{cube}_position"], own["tcp_position"]
        quarter = np.pi / 2
        yaw = (yaw_of(own[f"{cube}_quaternion"]) + quarter / 2) % quarter - quarter / 2
        turn = (leaning(yaw, lean_at(own)) * Rotation.from_quat(own["tcp_quaternion"]).inv()).magnitude()
        if distance(own, place) < 0.013 and turn < 0.12:
            return self._to(own, place, CLOSED, yaw)
        offset = place - tool
        lateral = float(np.linalg.norm(offset[:2])) + 0.1 * max(0.0, turn - 0.1)
        offset[2] += min(0.07, 4.0 * max(0.0, lateral - 0.01))
        offset[:2] *= np.clip(1.5 - offset[2] / 0.03, 0.0, 1.0)  # Up before across.
        return self._to(own, tool + offset, OPEN, yaw)

    def _to(self, own: State, target: FloatArray, gripper: float, yaw: float = 0.0) -> FloatArray:
        return go_turned(own, target, leaning(yaw, lean_at(own)), gripper=gripper)


class HandOver(_Cubes):
    """The first arm puts the cube down between the arms and withdraws, the second takes it to the goal."""

    middle = np.array([0.75, 0.0, 0.02])
    """Where the cube is handed over, in the frame of either base, at the limit of reach."""
    reached = 0.73
    """Distance from the first base beyond which the cube is the second arm's (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        first, second = (seen_by(arm, state, ("cube", "goal")) for arm in ARM_PREFIXES)
        waiting = self._to(second, self.aside, OPEN)
        if self._holds(second, "cube"):
            return np.concatenate([self._withdraw(first, "cube"), self._to(second, second["goal_position"], CLOSED)])
        if self._holds(first, "cube"):
            return np.concatenate([self._put(first, "cube", self.middle), waiting])
        if first["cube_position"][0] < self.reached:
            return np.concatenate([self._grasp(first, "cube"), waiting])
        waits = first["tcp_position"][0] > self.clear
        return np.concatenate([self._withdraw(first, "cube"), waiting if waits else self._grasp(second, "cube")])


class StackTogether(_Cubes):
    """The first arm lifts the blue cube, the second puts the green one on the target, then blue goes onto green.

    The target may be under the blue cube, and its near side is at the limit of the second arm's reach.
    """

    short = 0.04
    """How far on its own side of the target's centre the second arm puts the cube (m)."""
    on_target = 0.055
    """Largest distance of the green cube from the target's centre (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        first, second = (seen_by(arm, state, ("blue_cube", "green_cube", "goal")) for arm in ARM_PREFIXES)
        holds_blue, holds_green = self._holds(first, "blue_cube"), self._holds(second, "green_cube")
        green = first["green_cube_position"]
        missed = float(np.linalg.norm((green - first["goal_position"])[:2]))
        placed = missed < self.on_target and green[2] < 0.025 and not holds_green
        return np.concatenate(
            [
                self._first(first, holds_blue, placed and second["tcp_position"][0] < self.clear),
                self._second(second, holds_blue and first["tcp_position"][2] > 0.15, holds_green, placed),
            ]
        )

    def _first(self, own: State, holds: bool, may_stack: bool) -> FloatArray:
        top = own["green_cube_position"] + [0.0, 0.0, CUBE]
        offset = top - own["blue_cube_position"]
        if np.linalg.norm(offset[:2]) < 0.012 and abs(offset[2]) < 0.004:
            return self._withdraw(own, "blue_cube")
        if not holds:
            return self._grasp(own, "blue_cube")
        return self._put(own, "blue_cube", top) if may_stack else self._to(own, self.aside, CLOSED)

    def _second(self, own: State, may_place: bool, holds: bool, placed: bool) -> FloatArray:
        if placed:
            return self._withdraw(own, "green_cube")
        if not holds:
            return self._grasp(own, "green_cube")
        target = own["goal_position"] * [1.0, 1.0, 0.0] + [-self.short, 0.0, CUBE / 2]
        return self._put(own, "green_cube", target) if may_place else self._to(own, own["tcp_position"], CLOSED)


def grasp_bar(own: State, place: FloatArray, rotation: Rotation, to_turn: float, thickness: float) -> FloatArray:
    """Return one arm's action (7,) of a grasp of a bar: open, approach it from above within a funnel, close.

    `to_turn` (rad) is how far the gripper is from `rotation`, or from another that grasps it as well.
    """
    target, opening = place.copy(), float(own["finger_positions"].sum())
    lateral, far = distance(own, place, axes=slice(0, 2)), distance(own, place)
    if (far < 0.025 and 0.5 * thickness < opening < 0.07) or (far < 0.012 and to_turn < 0.2):
        return go(own, place, CLOSED, rotation)
    until_open = 0.08 if opening < 0.06 else 0.0
    target[2] += min(0.08, max(0.0, 5.0 * (lateral - 0.01), 0.4 * (to_turn - 0.15), until_open))
    return go(own, target, OPEN, rotation)


def seen_by(arm: str, state: State, things: Sequence[str]) -> State:
    """Return the state as one arm sees it: its own entries without the prefix, and things in the frame of its base.

    `arm` is one of `ARM_PREFIXES`; `things` are the names of what has a position, and may have a quaternion.
    """
    own = {name: state[arm + name] for name in ("tcp_position", "tcp_quaternion", "finger_positions")}
    origin, turn = np.zeros(3), Rotation.identity()
    if arm:
        origin, turn = state[f"{arm}base_position"], Rotation.from_quat(state[f"{arm}base_quaternion"]).inv()
    for thing in things:
        own[f"{thing}_position"] = turn.apply(state[f"{thing}_position"] - origin)
        if f"{thing}_quaternion" in state:
            own[f"{thing}_quaternion"] = (turn * Rotation.from_quat(state[f"{thing}_quaternion"])).as_quat()
    return own


BY_TASK: Mapping[str, Callable[[], Script]] = {
    "TwoArmLift": TwoArmLift,
    "TwoArmHandover": PassHammer,
    "TwoArmPegInHole": PegInHole,
}
"""robosuite's tasks to their scripts."""
SCRIPTS: Mapping[str, Callable[[], Script]] = {
    **scripts_of(2, BY_TASK),
    "maniskill/TwoRobotPickCube-v1@TwoPandas": HandOver,
    "maniskill/TwoRobotStackCube-v1@TwoPandas": StackTogether,
}
