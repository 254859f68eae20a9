"""Scripted oracles for ManiSkill. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.maniskill_motion import (
    CUBE,
    REST_YAW,
    STEP,
    XY,
    go,
    go_turned,
    grasp,
    grasp_turned,
    grasp_yaw,
    holds,
    hover,
    lean_at,
    leaning,
    let_go,
    line_yaw,
    to_goal,
    tool_yaw,
)
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, distance

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
        direction, remaining = to_goal(state)
        lean = lean_at(state)
        along = float((tcp - cube) @ direction)
        lateral = float(np.linalg.norm((tcp - cube - along * direction)[XY]))
        if tcp[2] < CUBE and lateral < self.slack and -1.6 * self.standoff < along < 0:
            target = cube + direction * (min(remaining, STEP) - CUBE / 2)
            return go(state, target, gripper=CLOSED, max_step=self.max_step, lean=lean)
        return hover(state, cube - direction * self.standoff, clearance=0.08, gripper=CLOSED, lean=lean)


class Pull:
    """Lowers the open fingers in front of and behind the cube, and pulls it onto the goal.

    In the rest pose the fingers open in the direction of the goal.
    """

    lead = 0.01
    """Distance ahead of the cube's centre, towards the goal, at which the gripper moves down (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube = state["cube_position"]
        direction, remaining = to_goal(state)
        if distance(state, cube, axes=XY) < 0.035 and state["tcp_position"][2] < CUBE:
            return go(state, cube + direction * (CUBE / 2 + min(remaining, 2 * STEP)), gripper=OPEN)
        return hover(state, cube + direction * self.lead, clearance=0.06, gripper=OPEN)


class Stack:
    """Grasps the red cube across two faces, moves it over the green one and releases it."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tcp, red, green = state["tcp_position"], state["red_cube_position"], state["green_cube_position"]
        to_place = green - red + np.array([0.0, 0.0, CUBE])
        if np.linalg.norm(to_place[XY]) < 0.015 and abs(to_place[2]) < 0.003:
            return let_go(state)
        if holds(state, red):
            yaw = tool_yaw(state)
            return hover(state, tcp + to_place, clearance=0.05, gripper=CLOSED, yaw=yaw)
        return grasp(state, red, grasp_yaw(state["red_cube_quaternion"], green - red))


class Pick:
    """Grasps the cube across two faces and holds it in the goal."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube, yaw = state["cube_position"], tool_yaw(state)
        if holds(state, cube):
            return go(state, state["tcp_position"] + state["goal_position"] - cube, gripper=CLOSED, yaw=yaw)
        return grasp(state, cube, grasp_yaw(state["cube_quaternion"], FAR))


class Place:
    """Grasps the sphere, carries it over the bin and lets it drop the last millimetres."""

    height = 0.0225
    """Height of the sphere's centre above the bin's when it is in it (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        sphere, tcp = state["sphere_position"], state["tcp_position"]
        to_place = state["bin_position"] - sphere + np.array([0.0, 0.0, self.height + 0.003])
        if np.linalg.norm(to_place[XY]) < 0.004 and abs(to_place[2]) < 0.005:
            return let_go(state)
        if holds(state, sphere, slack=0.015):  # Above or below its centre it is less wide.
            return hover(state, tcp + to_place, clearance=0.05, gripper=CLOSED)
        return grasp(state, sphere, REST_YAW)


class Pyramid:
    """Puts the red cube beside the green one, then the blue one on both."""

    beside = 0.056
    """Distance between the centres of neighbours (m): their diagonal."""
    slack = 0.005
    """What the distance may be longer, so that it is still a success (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tcp, yaw = state["tcp_position"], tool_yaw(state)
        red, green, blue = (state[f"{colour}_cube_position"] for colour in ("red", "green", "blue"))
        apart = (red - green) * [1.0, 1.0, 0.0]
        gap = float(np.linalg.norm(apart))
        if gap > self.beside + self.slack or holds(state, red):
            to_place = green + self.beside / gap * apart - red
            if np.linalg.norm(to_place[XY]) < self.slack and abs(to_place[2]) < 0.008:
                return let_go(state)
            if not holds(state, red):
                return grasp(state, red, grasp_yaw(state["red_cube_quaternion"], -self.beside / gap * apart))
            # Turned so that no finger comes between the two.
            turn = (np.arctan2(apart[1], apart[0]) - yaw + np.pi / 2) % np.pi - np.pi / 2
            place = tcp + to_place
            return hover(state, place, clearance=0.07, gripper=CLOSED, yaw=yaw + turn, to_turn=abs(turn))
        to_place = (red + green) / 2 + np.array([0.0, 0.0, CUBE]) - blue
        if np.linalg.norm(to_place[XY]) < self.slack and abs(to_place[2]) < 0.008:
            return let_go(state)
        if holds(state, blue):
            return hover(state, tcp + to_place, clearance=0.07, gripper=CLOSED, yaw=yaw)
        return grasp(state, blue, grasp_yaw(state["blue_cube_quaternion"], red - blue))


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
        if not holds(state, held, width=self.width):
            end = peg + float(np.clip(self.place - peg[0], -0.01, 0.08)) * axis
            return grasp(state, end, line_yaw(axis), lean=self.leans[0])
        height = self.half_length * np.sin(tilt)
        if tilt > self.turned:
            below = height + 0.022 * np.cos(tilt) - peg[2]
            pull = -0.02 if below > -0.006 and tilt < np.pi / 2 - 0.02 else 0.0
            target = tcp + np.array([pull, 0.0, below])
            return go(state, target, gripper=CLOSED, yaw=0.0, lean=self.leans[1], max_step=0.012)
        target = tcp + np.array([0.0, 0.0, height + 0.07 - peg[2]])
        lifted = bool(tilt > 0.3 or peg[2] > 0.065)
        if lifted:
            target[0] = self.place
        return go(state, target, gripper=CLOSED, yaw=0.0, lean=self.leans[lifted])


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
        along = line_yaw(turned.apply([1.0, 0.0, 0.0]))
        end = state["peg_position"] + turned.apply(self.grip)
        head = state["peg_position"] + turned.apply([self.half_length, 0.0, 0.0])
        if not holds(state, end, width=self.width):
            return grasp(state, end, along)
        aside = float((cube - head)[1])
        if np.linalg.norm((goal - cube)[XY]) < 0.04:
            return go(state, tcp, gripper=CLOSED, yaw=0.0)
        beside = abs(aside) > 0.01
        if beside and head[0] > cube[0] - self.behind:
            return go(state, tcp - np.array([STEP, 0.0, 0.0]), gripper=CLOSED, yaw=0.0, max_step=0.02)
        ahead = 0.0 if beside else STEP
        return go(state, tcp + np.array([ahead, aside, 0.0]), gripper=CLOSED, yaw=0.0, max_step=0.02)


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
        along = line_yaw(turned.apply([1.0, 0.0, 0.0]))
        end = state["tool_position"] + turned.apply(self.grip)
        hook = state["tool_position"] + turned.apply(self.inside)
        if not holds(state, end, width=self.width):
            return grasp(state, end, along)
        beyond, aside = hook - cube - [CUBE / 2, 0.0, 0.0], float((cube - hook)[1])
        if hook[2] < 0.05 and abs(aside) < 0.04 and -0.02 < beyond[0] < 0.08:
            return go(state, tcp + np.array([-STEP, aside, 0.0]), gripper=CLOSED, yaw=0.0, max_step=0.02)
        place = tcp + np.array([0.03 - beyond[0], aside, 0.03 - hook[2]])
        return hover(state, place, clearance=0.12, gripper=CLOSED, yaw=0.0, lean=0.5)


class Plug:
    """Grasps the charger with the hand leaning away from the socket, aligns it before the socket and pushes it in."""

    width, grip = 0.03, np.array([-0.02, 0.0, 0.0])
    """Width of the charger, and where the fingers hold it in its own frame (m)."""
    lean = 0.26
    """Lean of the hand (rad)."""
    before = 0.05
    """Distance from its place in the socket at which it is aligned (m)."""
    prongs = 0.018
    """Distance from its place in the socket beyond which its prongs are still outside (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tcp, tool = state["tcp_position"], Rotation.from_quat(state["tcp_quaternion"])
        charger, turned = state["charger_position"], Rotation.from_quat(state["charger_quaternion"])
        held = charger + turned.apply(self.grip)
        if not holds(state, held, width=self.width):
            yaw = line_yaw(turned.apply([1.0, 0.0, 0.0]))
            return grasp_turned(state, held, Rotation.from_euler("z", yaw) * leaning(0.0, self.lean))
        wanted = Rotation.from_quat(state["socket_quaternion"]) * Rotation.from_euler("z", np.pi)
        into, turn = wanted.apply([1.0, 0.0, 0.0]), wanted * turned.inv()
        offset = state["socket_position"] - charger
        remaining = float(offset @ into)
        aside = offset - remaining * into
        missed, to_turn = float(np.linalg.norm(aside)), float(turn.magnitude())
        lever = charger - tcp  # The hand turns about the tool, and the charger with it.
        target = tcp + lever - turn.apply(lever)
        if remaining < self.before + 0.01 and missed < 0.01 and to_turn < 0.1:
            if remaining > self.prongs:  # The better it is aligned, the faster: the socket leaves 0.5 mm.
                forward = 0.008 * max(0.0, 1.0 - missed / 0.0008 - to_turn / 0.02)
            else:
                forward = 0.008 if missed < 0.002 else -0.02
            target += aside + forward * into
        else:
            # Farther away until it is turned: a corner of the hand could hit the socket.
            target += offset - (self.before + min(0.06, 0.3 * max(0.0, to_turn - 0.05))) * into
            if np.linalg.norm(target - tcp) > 0.06 and tcp[2] < 0.1:  # Up before across.
                target[2] = max(target[2], tcp[2] + 0.02)
        return go_turned(state, target, turn * tool, gripper=CLOSED)


class Roll:
    """Pushes the ball with two fingertips towards the goal, ever faster, and lets it roll on from the arm's end.

    A ball near the robot, behind which the hand has no room, is first carried forward. One that has rolled out of reach
    cannot be pushed again.
    """

    radius, width = 0.035, 0.064
    """The ball's radius, and the distance between the fingers that hold it (m)."""
    near, end = 0.36, 0.66
    """Distances ahead of the base from which on there is room behind the ball, and at which the push ends (m)."""
    behind = 0.065
    """Distance of the gripper from the ball's centre before the push (m)."""
    speeds = 0.01, 0.016
    """Translation in one control step at the beginning of the push, and at most (m)."""
    gap = -0.2
    """Gripper command (-1 open, 1 closed) at which the ball is too wide for the gap and touches both fingertips."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        ball, tcp, tool = state["ball_position"], state["tcp_position"], Rotation.from_quat(state["tcp_quaternion"])
        held = holds(state, ball, width=self.width, slack=0.006)
        if held or ball[0] < self.near or distance(state, ball) < self.radius:
            return self._bring(state, held=held)
        direction, _ = to_goal(state, "ball")
        yaw = line_yaw(direction)
        to_turn = float((leaning(yaw, 0.0) * tool.inv()).magnitude())
        along = float((tcp - ball) @ direction)
        aside = (tcp - ball - along * direction) * [1.0, 1.0, 0.0]
        slack = 0.015 if along > -0.058 else 0.003  # Exact before the push, which then keeps to the line.
        behind = -1.3 * self.behind < along < 0.0 and np.linalg.norm(aside) < slack
        if behind and abs(tcp[2] - self.radius) < 0.012 and to_turn < 0.1 and tcp[0] < self.end:
            speed = float(np.clip(self.speeds[0] + 0.1 * (tcp[0] - self.near), *self.speeds))
            # The arm follows a motion across its own less than one along it.
            target = tcp + direction * [0.2, 0.22, 0.0] - aside
            target[2] = self.radius
            return go(state, target, gripper=self.gap, yaw=yaw, max_step=speed)
        if ball[0] > self.end - 0.06:
            return go(state, tcp, gripper=self.gap, yaw=yaw)
        place = ball - direction * self.behind
        return hover(state, place, clearance=0.12, gripper=self.gap, yaw=yaw, to_turn=to_turn)

    def _bring(self, state: State, *, held: bool) -> FloatArray:
        """Carry the ball to where there is room behind it, and let it go there."""
        ball, tcp = state["ball_position"], state["tcp_position"]
        if ball[0] >= self.near and ball[2] < self.radius + 0.004:
            rise = STEP if float(state["finger_positions"].sum()) > 0.075 else 0.0
            yaw = tool_yaw(state)
            return go(state, tcp + np.array([0.0, 0.0, rise]), gripper=OPEN, yaw=yaw)
        if not held:
            return grasp(state, ball, 0.0)
        place = np.array([self.near + 0.04, np.clip(ball[1], -0.2, 0.2), self.radius])
        return hover(state, tcp + place - ball, clearance=0.03, gripper=CLOSED, yaw=0.0)


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
    "maniskill/PlugCharger-v1": Plug,
    "maniskill/RollBall-v1": Roll,
}
