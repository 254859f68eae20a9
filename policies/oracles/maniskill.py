"""Scripted oracles for ManiSkill. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, distance, move, pointing_down, yaw_of

STEP = 0.03
"""Longest translation in one control step (m)."""
TURN = 0.039
"""Largest rotation in one control step (rad), the controller's limit."""
GAIN = 0.6
REST_YAW = np.pi / 2
"""The gripper's rotation about the vertical in ManiSkill's rest pose (rad)."""
CUBE = 0.04
"""Edge of every cube (m)."""
XY = slice(0, 2)
FAR = np.ones(3)
"""Where the nearest other cube is, if there is none (m)."""


class Push:
    """Pushes the cube onto the goal with closed fingers, from behind and slowly enough that it stops with them.

    The goal is at the limit of the arm's reach: the farther out, the more the gripper leans forward.
    """

    standoff = 0.055
    """Distance between the centres of cube and gripper before the push (m)."""
    slack = 0.015
    """Largest distance of the gripper from the line from cube to goal while it pushes (m)."""
    max_step = 0.014
    """Longest translation in one step of the push (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube, tcp = state["cube_position"], state["tcp_position"]
        direction, remaining = _to_goal(state)
        lean = float(np.clip(3.0 * (tcp[0] - 0.6), 0.0, 0.45))
        along = float((tcp - cube) @ direction)
        lateral = float(np.linalg.norm((tcp - cube - along * direction)[XY]))
        if tcp[2] < CUBE and lateral < self.slack and -1.6 * self.standoff < along < 0:
            target = cube + direction * (min(remaining, STEP) - CUBE / 2)
            return _move(state, target, gripper=CLOSED, max_step=self.max_step, lean=lean)
        return _hover(state, cube - direction * self.standoff, clearance=0.08, gripper=CLOSED, lean=lean)


class Pull:
    """Lowers the open fingers in front of and behind the cube, and pulls it onto the goal.

    In the rest pose the fingers open in the direction of the goal.
    """

    lead = 0.01
    """Distance ahead of the cube's centre, towards the goal, at which the gripper moves down (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube = state["cube_position"]
        direction, remaining = _to_goal(state)
        if distance(state, cube, axes=XY) < 0.035 and state["tcp_position"][2] < CUBE:
            return _move(state, cube + direction * (CUBE / 2 + min(remaining, 2 * STEP)), gripper=OPEN)
        return _hover(state, cube + direction * self.lead, clearance=0.06, gripper=OPEN)


class Stack:
    """Grasps the red cube across two faces, moves it over the green one and releases it."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tcp, red, green = state["tcp_position"], state["red_cube_position"], state["green_cube_position"]
        to_place = green - red + np.array([0.0, 0.0, CUBE])
        if np.linalg.norm(to_place[XY]) < 0.015 and abs(to_place[2]) < 0.003:
            return _let_go(state)
        if _holds(state, red):
            yaw = _yaw(Rotation.from_quat(state["tcp_quaternion"]))
            return _hover(state, tcp + to_place, clearance=0.05, gripper=CLOSED, yaw=yaw)
        return _grasp(state, red, _grasp_yaw(state["red_cube_quaternion"], green - red))


class Pick:
    """Grasps the cube across two faces and holds it in the goal."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube, yaw = state["cube_position"], _yaw(Rotation.from_quat(state["tcp_quaternion"]))
        if _holds(state, cube):
            return _move(state, state["tcp_position"] + state["goal_position"] - cube, gripper=CLOSED, yaw=yaw)
        return _grasp(state, cube, _grasp_yaw(state["cube_quaternion"], FAR))


class Place:
    """Grasps the sphere, carries it over the bin and lets it drop the last millimetres."""

    height = 0.0225
    """Height of the sphere's centre above the bin's when it is in it (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        sphere, tcp = state["sphere_position"], state["tcp_position"]
        to_place = state["bin_position"] - sphere + np.array([0.0, 0.0, self.height + 0.003])
        if np.linalg.norm(to_place[XY]) < 0.004 and abs(to_place[2]) < 0.005:
            return _let_go(state)
        if _holds(state, sphere, slack=0.015):  # Above or below its centre it is less wide.
            return _hover(state, tcp + to_place, clearance=0.05, gripper=CLOSED)
        return _grasp(state, sphere, REST_YAW)


class Pyramid:
    """Puts the red cube beside the green one, then the blue one on both."""

    beside = 0.056
    """Distance between the centres of neighbours (m): their diagonal."""
    slack = 0.005
    """What the distance may be longer, so that it is still a success (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tcp, yaw = state["tcp_position"], _yaw(Rotation.from_quat(state["tcp_quaternion"]))
        red, green, blue = (state[f"{colour}_cube_position"] for colour in ("red", "green", "blue"))
        apart = (red - green) * [1.0, 1.0, 0.0]
        gap = float(np.linalg.norm(apart))
        if gap > self.beside + self.slack or _holds(state, red):
            to_place = green + self.beside / gap * apart - red
            if np.linalg.norm(to_place[XY]) < self.slack and abs(to_place[2]) < 0.008:
                return _let_go(state)
            if not _holds(state, red):
                return _grasp(state, red, _grasp_yaw(state["red_cube_quaternion"], -self.beside / gap * apart))
            # Turned so that no finger comes between the two.
            turn = (np.arctan2(apart[1], apart[0]) - yaw + np.pi / 2) % np.pi - np.pi / 2
            place = tcp + to_place
            return _hover(state, place, clearance=0.07, gripper=CLOSED, yaw=yaw + turn, to_turn=abs(turn))
        to_place = (red + green) / 2 + np.array([0.0, 0.0, CUBE]) - blue
        if np.linalg.norm(to_place[XY]) < self.slack and abs(to_place[2]) < 0.008:
            return _let_go(state)
        if _holds(state, blue):
            return _hover(state, tcp + to_place, clearance=0.07, gripper=CLOSED, yaw=yaw)
        return _grasp(state, blue, _grasp_yaw(state["blue_cube_quaternion"], red - blue))


class Upright:
    """Grasps the peg near its far end, lifts and turns it, and pulls it upright with its near end on the table.

    The wrist cannot turn the hand through a right angle, so the last of it is done by the table.
    """

    width = 0.05
    """Width of the peg (m)."""
    half_length = 0.12
    """Half of its length (m)."""
    leans = -0.3, 1.0
    """Lean of the hand when it grasps the peg, and when it has turned it (rad)."""
    place = 0.7
    """Where it turns the peg, ahead of the base (m)."""
    turned = 1.05
    """Tilt of the peg from which on it is pulled (rad)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        peg, tcp = state["peg_position"], state["tcp_position"]
        axis = Rotation.from_quat(state["peg_quaternion"]).apply([1.0, 0.0, 0.0])
        axis = axis if axis[0] + axis[2] > 0 else -axis
        tilt = float(np.arcsin(np.clip(axis[2], 0.0, 1.0)))
        held = peg + float(np.clip((tcp - peg) @ axis, -0.02, 0.1)) * axis
        if not _holds(state, held, width=self.width):
            end = peg + float(np.clip(self.place - peg[0], -0.01, 0.08)) * axis
            return _grasp(state, end, _line_yaw(axis), lean=self.leans[0])
        height = self.half_length * np.sin(tilt)
        if tilt > self.turned:
            below = height + 0.022 * np.cos(tilt) - peg[2]
            pull = -0.02 if below > -0.006 and tilt < np.pi / 2 - 0.02 else 0.0
            target = tcp + np.array([pull, 0.0, below])
            return _move(state, target, gripper=CLOSED, yaw=0.0, lean=self.leans[1], max_step=0.012)
        target = tcp + np.array([0.0, 0.0, height + 0.07 - peg[2]])
        lifted = tilt > 0.3 or peg[2] > 0.065
        if lifted:
            target[0] = self.place
        return _move(state, target, gripper=CLOSED, yaw=0.0, lean=self.leans[lifted])


class Poke:
    """Grasps the peg near its end, moves its head behind the cube and pushes the cube onto the goal with it."""

    width = 0.05
    """Width of the peg (m)."""
    half_length = 0.12
    """Half of its length (m)."""
    grip = np.array([-0.085, 0.0, 0.0])
    """Where the fingers hold it, from its centre in its own frame (m)."""
    behind = 0.035
    """Distance of its head from the cube's centre at which it moves aside (m): the cube may be turned."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube, goal, tcp = state["cube_position"], state["goal_position"], state["tcp_position"]
        turned = Rotation.from_quat(state["peg_quaternion"])
        along = _line_yaw(turned.apply([1.0, 0.0, 0.0]))
        end = state["peg_position"] + turned.apply(self.grip)
        head = state["peg_position"] + turned.apply([self.half_length, 0.0, 0.0])
        if not _holds(state, end, width=self.width):
            return _grasp(state, end, along)
        aside = float((cube - head)[1])
        if np.linalg.norm((goal - cube)[XY]) < 0.04:
            return _move(state, tcp, gripper=CLOSED, yaw=0.0)
        beside = abs(aside) > 0.01
        if beside and head[0] > cube[0] - self.behind:
            return _move(state, tcp - np.array([STEP, 0.0, 0.0]), gripper=CLOSED, yaw=0.0, max_step=0.02)
        ahead = 0.0 if beside else STEP
        return _move(state, tcp + np.array([ahead, aside, 0.0]), gripper=CLOSED, yaw=0.0, max_step=0.02)


class Hook:
    """Grasps the tool at its end, lifts its hook over the cube, and pulls the cube towards the robot."""

    width = 0.05
    """Width of the tool (m)."""
    grip = np.array([0.03, 0.0, 0.0])
    """Where the fingers hold it, in its own frame (m)."""
    inside = np.array([0.15, 0.06, 0.0])
    """Middle of the inner side of its hook, in its own frame (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube, tcp = state["cube_position"], state["tcp_position"]
        turned = Rotation.from_quat(state["tool_quaternion"])
        along = _line_yaw(turned.apply([1.0, 0.0, 0.0]))
        end = state["tool_position"] + turned.apply(self.grip)
        hook = state["tool_position"] + turned.apply(self.inside)
        if not _holds(state, end, width=self.width):
            return _grasp(state, end, along)
        beyond, aside = hook - cube - [CUBE / 2, 0.0, 0.0], float((cube - hook)[1])
        if hook[2] < 0.05 and abs(aside) < 0.04 and -0.02 < beyond[0] < 0.08:
            return _move(state, tcp + np.array([-STEP, aside, 0.0]), gripper=CLOSED, yaw=0.0, max_step=0.02)
        place = tcp + np.array([0.03 - beyond[0], aside, 0.03 - hook[2]])
        return _hover(state, place, clearance=0.12, gripper=CLOSED, yaw=0.0, lean=0.5)


def _holds(state: State, place: FloatArray, *, width: float = CUBE, slack: float = 0.004) -> bool:
    """Return whether the fingers hold something so wide, within `slack` (m), at a place."""
    return distance(state, place) < 0.025 and abs(float(state["finger_positions"].sum()) - width) < slack


def _grasp(state: State, place: FloatArray, yaw: float, *, lean: float = 0.0) -> FloatArray:
    """Return one action (7,) of a grasp: open, approach the place from above, close."""
    to_turn = float((_leaning(yaw, lean) * Rotation.from_quat(state["tcp_quaternion"]).inv()).magnitude())
    if distance(state, place) < 0.013 and to_turn < 0.1:
        return _move(state, place, gripper=CLOSED, yaw=yaw, lean=lean)
    return _hover(state, place, clearance=0.07, gripper=OPEN, yaw=yaw, lean=lean, to_turn=to_turn)


def _let_go(state: State) -> FloatArray:
    """Return one action (7,) that opens the fingers, and then withdraws them upwards."""
    yaw = _yaw(Rotation.from_quat(state["tcp_quaternion"]))
    retreat = [0.0, 0.0, STEP if float(state["finger_positions"].sum()) > CUBE + 0.02 else 0.0]
    return _move(state, state["tcp_position"] + retreat, gripper=OPEN, yaw=yaw)


def _to_goal(state: State) -> tuple[FloatArray, float]:
    """Return the horizontal direction (3,) from cube to goal, and the distance (m)."""
    offset = (state["goal_position"] - state["cube_position"]) * [1.0, 1.0, 0.0]
    remaining = float(np.linalg.norm(offset))
    return offset / max(remaining, 1e-6), remaining


def _move(
    state: State,
    target: FloatArray,
    *,
    gripper: float,
    yaw: float = REST_YAW,
    lean: float = 0.0,
    max_step: float = STEP,
) -> FloatArray:
    """Return one action (7,) towards `target`, pointing down except for `lean` (rad), fingers ahead of the hand."""
    rotation = _leaning(yaw, lean)
    return move(state, target, gripper=gripper, max_step=max_step, gain=GAIN, rotation=rotation, max_turn=TURN)


def _leaning(yaw: float, lean: float) -> Rotation:
    """Return the orientation of a gripper that points down except for `lean` (rad), fingers ahead of the hand."""
    return Rotation.from_euler("y", -lean) * pointing_down(yaw)


def _hover(
    state: State,
    target: FloatArray,
    *,
    clearance: float,
    gripper: float,
    yaw: float = REST_YAW,
    lean: float = 0.0,
    to_turn: float = 0.0,
) -> FloatArray:
    """Return one action (7,) in a funnel above `target`: the farther or less turned, the higher; up before across."""
    offset = target - state["tcp_position"]
    lateral = float(np.linalg.norm(offset[XY])) + 0.1 * max(0.0, to_turn - 0.05)
    offset[2] += min(clearance, 4.0 * max(0.0, lateral - 0.01))
    offset[XY] *= np.clip(1.5 - offset[2] / 0.03, 0.0, 1.0)
    return _move(state, state["tcp_position"] + offset, gripper=gripper, yaw=yaw, lean=lean)


def _yaw(gripper: Rotation) -> float:
    """Return the yaw (rad) for which `pointing_down` is closest to the gripper's orientation."""
    return yaw_of((gripper * pointing_down(0.0).inv()).as_quat())


def _line_yaw(axis: FloatArray) -> float:
    """Return the gripper's yaw (rad) to grasp something long across its horizontal axis, the one nearest to zero."""
    yaw = float(np.arctan2(axis[1], axis[0]))
    return (yaw + np.pi / 2) % np.pi - np.pi / 2


def _grasp_yaw(quaternion: FloatArray, neighbour: FloatArray) -> float:
    """Return the gripper's yaw (rad) to grasp a cube across two faces.

    Of the two within a right angle of the rest pose, it is the nearer one, unless the fingers would hit another cube,
    whose centre is at `neighbour` relative to this one's (m).
    """
    near = REST_YAW + (yaw_of(quaternion) - REST_YAW + np.pi / 4) % (np.pi / 2) - np.pi / 4
    far = near - np.copysign(np.pi / 2, near - REST_YAW)
    if np.linalg.norm(neighbour[XY]) > 0.11:
        return float(near)
    # The fingers open along the gripper's y axis, at a right angle to its yaw.
    away = np.arctan2(neighbour[1], neighbour[0])
    return float(min((near, far), key=lambda yaw: abs(np.sin(yaw - away))))


SCRIPTS: dict[str, Callable[[], Script]] = {
    "maniskill/PushCube-v1": Push,
    "maniskill/PullCube-v1": Pull,
    "maniskill/StackCube-v1": Stack,
    "maniskill/PickCube-v1": Pick,
    "maniskill/PlaceSphere-v1": Place,
    "maniskill/StackPyramid-v1": Pyramid,
    "maniskill/LiftPegUpright-v1": Upright,
    "maniskill/PokeCube-v1": Poke,
    "maniskill/PullCubeTool-v1": Hook,
}
