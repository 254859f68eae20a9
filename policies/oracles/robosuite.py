"""Scripted oracles for robosuite. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.catalog import simulators
from robogauntlet.adapters.contract import FloatArray, TaskDescription
from robogauntlet.policies.oracles.joints import ByJoints
from robogauntlet.policies.oracles.motion import (
    CLOSED,
    OPEN,
    Script,
    State,
    distance,
    limit,
    move,
    pointing_down,
    yaw_of,
)
from robogauntlet.suites.episode import AT

MAX_STEP, MAX_TURN = 0.0153, 0.153
"""Largest motion in one step (m, rad), the controller's limit."""
SLOWER_STEP, SLOWER_TURN = 0.0105, 0.085
"""The same for the slowest of the other arms."""
BY_JOINTS_HZ = 15.0
"""Control steps per second of the tasks that are played by joints."""
GAIN = 0.306
"""Share of the remaining distance in one step, the largest that this controller follows without overshoot."""
UP = np.array([0.0, 0.0, 1.0])


class Lift:
    """Grasps the cube and lifts it."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        yaw = grasp_yaw(state, "cube")
        if not holds(state, "cube"):
            return grasp(state, "cube", yaw)
        return go(state, state["tcp_position"] + 0.05 * UP, CLOSED, pointing_down(yaw))


class Stack:
    """Grasps the red cube, moves it over the green one, lowers it and releases it."""

    stacked = 0.045
    """Height of the red cube's centre above the green one's (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        red, green = state["cubeA_position"], state["cubeB_position"]
        rotation = pointing_down(grasp_yaw(state, "cubeA"))
        to_goal = green + self.stacked * UP - red
        lateral = float(np.linalg.norm(to_goal[:2]))
        opening = float(state["finger_positions"].sum())
        if lateral < 0.015 and abs(to_goal[2]) < 0.006:
            free = opening > 0.06 or distance(state, red) > 0.03
            return go(state, state["tcp_position"] + (0.04 * UP if free else 0.0), OPEN, rotation)
        if not holds(state, "cubeA"):
            return grasp(state, "cubeA", grasp_yaw(state, "cubeA", obstacle=green))
        # Up first, then across, then down a funnel.
        to_goal[2] += min(0.04, max(0.0, 4.0 * (lateral - 0.008)))
        to_goal[:2] *= float(np.clip(1.0 - (to_goal[2] - 0.01) / 0.02, 0.0, 1.0))
        return go(state, state["tcp_position"] + to_goal, CLOSED, rotation)


class Door:
    """Grasps the handle, turns it down until the latch is free, and pulls the door open.

    The fingers grasp the handle from above and in front, and turn with it; otherwise they would slip off.
    """

    tilt = np.radians(50.0)
    """Angle of the gripper from pointing down towards the door (rad). The palm is too wide to point straight down."""
    handle_depth = 0.1
    """Distance from the latch's axis to the middle of the handle, along the door's normal (m)."""
    lever_arm = 0.1
    """Distance from the latch's axis to the grasp (m)."""
    unlatched = 1.25
    """Angle of the handle (rad) at which pulling starts. The latch is free at 1.2."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        door = Rotation.from_quat(state["door_quaternion"])
        normal = -door.apply([0.0, 1.0, 0.0])
        turned, opened = float(state["latch_angle"][0]), float(state["hinge_angle"][0])
        pivot = state["latch_position"] + self.handle_depth * normal

        def handle(angle: float) -> FloatArray:
            turn = Rotation.from_rotvec(-angle * normal)
            return pivot + self.lever_arm * turn.apply(door.apply([1.0, 0.0, 0.0]))

        facing = Rotation.from_euler("z", yaw_of(state["door_quaternion"]) - np.pi)
        leaning = facing * Rotation.from_euler("x", -self.tilt) * pointing_down(0.0)
        rotation = Rotation.from_rotvec(-turned * normal) * leaning
        pointing = rotation.apply(UP)

        tcp = state["tcp_position"]
        offset = tcp - handle(turned)
        depth = float(offset @ pointing)
        lateral = float(np.linalg.norm(offset - depth * pointing))
        angle_error = (rotation * Rotation.from_quat(state["tcp_quaternion"]).inv()).magnitude()
        opening = float(state["finger_positions"].sum())

        # The handle springs back, so a turned one is in the gripper; turning may force the fingers open.
        gripped = opening < 0.06 or turned > 0.3
        held = gripped and lateral < 0.03 and abs(depth) < 0.03
        hooked = gripped and lateral < 0.045 and abs(depth) < 0.045
        if (hooked and opened > 0.02) or (held and turned > self.unlatched):
            return go(state, tcp + 0.05 * normal, CLOSED, rotation)
        if held:
            return go(state, tcp + handle(turned + 0.4) - handle(turned), CLOSED, rotation)
        closing = lateral < 0.02 and abs(depth) < 0.02 and opening < 0.07
        if closing or (lateral < 0.01 and abs(depth) < 0.015 and angle_error < 0.2):
            return go(state, handle(turned), CLOSED, rotation)
        until_open = 0.1 if opening < 0.06 else 0.0
        back = min(0.1, max(0.0, 4.0 * (lateral - 0.008), 0.4 * (angle_error - 0.15), until_open))
        return go(state, handle(turned) - back * pointing, OPEN, rotation)


class Wipe:
    """Presses the tool on the table, and draws it to the nearest spot of dirt that is left."""

    pressed = 0.012
    """Depth below the table's top at which the tool is aimed (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tool, target = state["tcp_position"], state["tcp_position"]
        left = state["dirt_places"][state["dirt_wiped"] == 0.0]
        if len(left):
            target = left[np.linalg.norm((left - tool)[:, :2], axis=1).argmin()] - self.pressed * UP
        return go(state, target, CLOSED, pointing_down(0.0))


def go(state: State, target: FloatArray, gripper: float, rotation: Rotation) -> FloatArray:
    """Return one action (7,) towards a pose, within these oracles' limits."""
    return move(state, target, gripper=gripper, max_step=MAX_STEP, gain=GAIN, rotation=rotation, max_turn=MAX_TURN)


def tool_yaw(state: State) -> float:
    """Return the rotation of the downward gripper about the vertical (rad)."""
    return yaw_of((Rotation.from_quat(state["tcp_quaternion"]) * Rotation.from_euler("x", np.pi)).as_quat())


def grasp_yaw(state: State, cube: str, obstacle: FloatArray | None = None) -> float:
    """Return the nearest yaw (rad) of a grasp across two faces of the cube, or the next if an obstacle blocks it."""
    current = tool_yaw(state)
    quarter = np.pi / 2
    turn = (yaw_of(state[f"{cube}_quaternion"]) - current + quarter / 2) % quarter - quarter / 2
    if obstacle is not None:
        to_obstacle = (obstacle - state[f"{cube}_position"])[:2]
        finger_axis = np.array([-np.sin(current + turn), np.cos(current + turn)])
        if np.linalg.norm(to_obstacle) < 0.1 and abs(finger_axis @ to_obstacle) > 0.75 * np.linalg.norm(to_obstacle):
            turn += -quarter if turn > 0 else quarter
    return current + turn


def holds(state: State, cube: str) -> bool:
    """Return whether the fingers hold the cube."""
    return around(state, cube, 0.02) and 0.03 < float(state["finger_positions"].sum()) < 0.047


def around(state: State, cube: str, slack: float) -> bool:
    """Return whether the cube's centre is between the fingers, within `slack` (m) laterally and in height."""
    offset = state[f"{cube}_position"] - state["tcp_position"]
    return bool(np.linalg.norm(offset[:2]) < slack and abs(offset[2]) < slack)


def grasp(state: State, cube: str, yaw: float) -> FloatArray:
    """Return one action (7,) of a grasp: open, approach the cube from above within a funnel, close.

    Fingers continue to close with less precision than they need to start: otherwise noise stops them halfway.
    """
    target = state[f"{cube}_position"].copy()
    opening = float(state["finger_positions"].sum())
    lateral = float(np.linalg.norm((target - state["tcp_position"])[:2]))
    angle_error = abs(yaw - tool_yaw(state))
    closing = around(state, cube, 0.018) and 0.03 < opening < 0.07
    if closing or (around(state, cube, 0.01) and angle_error < 0.2 and opening > 0.03):
        return go(state, target, CLOSED, pointing_down(yaw))
    until_open = 0.08 if opening < 0.06 else 0.0
    target[2] += min(0.08, max(0.0, 5.0 * (lateral - 0.01), 0.4 * (angle_error - 0.15), until_open))
    return go(state, target, OPEN, pointing_down(yaw))


class PickPlace:
    """Grasps an object across its narrow side, carries it over the bins' walls and drops it into its compartment."""

    clearance = 0.18
    """Height above its place at which the object is carried (m)."""
    slope = 4.0
    """Descent towards the place, for each metre."""
    reach = 0.79
    """Distance from the base at which the arm can still be steered (m)."""

    def __init__(self, name: str, width: float, above: float, goal: str = "goal") -> None:
        """Take the names of object and place, its narrow side, and the height of the grasp above its centre (m)."""
        self._name, self._width, self._above, self._goal = name, width, above, f"{goal}_position"

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        centre, tcp = state[f"{self._name}_position"], state["tcp_position"]
        yaw = across(state, f"{self._name}_quaternion")
        goal = state[self._goal].copy()
        goal[:2] = limit(goal[:2], self.reach)  # Still within its compartment.
        to_goal = goal - centre
        lateral = float(np.linalg.norm(to_goal[:2]))
        if lateral < 0.05 and to_goal[2] > -0.07:
            return go(state, tcp + (0.05 * UP if opened(state, self._width) else 0.0), OPEN, pointing_down(yaw))
        grip = centre + self._above * UP
        if not gripped(state, grip, self._width):
            return grasp_at(state, grip, yaw, self._width)
        to_goal[2] += min(self.clearance, self.slope * max(0.0, lateral - 0.02))
        to_goal[:2] *= float(np.clip(1.0 - (to_goal[2] - 0.03) / 0.05, 0.0, 1.0))
        return go(state, tcp + to_goal, CLOSED, pointing_down(yaw))


class PickPlaceOver(PickPlace):
    """The same, carried over other objects: higher, and lower where the arm is stretched."""

    clearance, slope = 0.28, 1.2


class NutAssembly:
    """Grasps a nut by its handle, brings its hole over the peg and lowers it."""

    width, reach = 0.032, 0.066
    """Width of the handle, distance of the grasp from the middle of the hole (m)."""
    clearance = 0.12

    def __init__(self, nut: str = "nut", peg: str = "peg") -> None:
        """Take the names of the nut and of its peg."""
        self._nut, self._turn, self._peg = f"{nut}_position", f"{nut}_quaternion", f"{peg}_position"

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        nut, tcp = state[self._nut], state["tcp_position"]
        handle = nut + Rotation.from_quat(state[self._turn]).apply([self.reach, 0.0, 0.0])
        yaw = across(state, self._turn)
        to_peg = state[self._peg] - nut
        lateral = float(np.linalg.norm(to_peg[:2]))
        if lateral < 0.015 and to_peg[2] > -0.06:
            return go(state, tcp + (0.05 * UP if opened(state, self.width) else 0.0), OPEN, pointing_down(yaw))
        if not gripped(state, handle, self.width):
            return grasp_at(state, handle, yaw, self.width)
        turned = yaw_of(state[self._turn])
        # The peg is square, and too far away to be reached by a handle that points away from the robot.
        straight = min((_wrapped(turned - goal) for goal in (-np.pi / 2, np.pi / 2, np.pi)), key=abs)
        to_peg[2] += min(self.clearance, max(0.0, 20.0 * (lateral - 0.004), 0.5 * (abs(straight) - 0.05)))
        to_peg[:2] *= float(np.clip(1.0 - (to_peg[2] - 0.02) / 0.03, 0.0, 1.0))
        return go(state, tcp + to_peg, CLOSED, pointing_down(tool_yaw(state) - straight))


class OneByOne:
    """Brings several objects to their goals, each by its script: the one in the gripper, else the one with most room.

    From a goal the arm is drawn in before it reaches for the next object: stretched, it cannot turn to it, nor keep the
    gripper vertical on the way.
    """

    away, carried = 0.1, 0.03
    """Distance of the tool from an object that it has left, and height above the goal of one that it carries (m)."""
    stretched, drawn_in, tilted = 0.6, 0.42, 0.2
    """Horizontal distances of the tool from the base (m), and its angle from the vertical (rad)."""

    def __init__(self, scripts: Mapping[tuple[str, str], Script], near: tuple[float, float, float]) -> None:
        """Take the script of each object and goal, by their names, and how near they are at the end, by axis (m)."""
        self._scripts, self._near = scripts, near

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        waiting: list[tuple[FloatArray, Script]] = []
        reached: list[FloatArray] = []
        for (name, goal), script in self._scripts.items():
            place, end = state[f"{name}_position"], state[f"{goal}_position"]
            there = bool(np.all(np.abs(place - end) < self._near))
            if (there and distance(state, place) < self.away) or place[2] > end[2] + self.carried:
                return script(state)
            if there:
                reached.append(end)
            else:
                waiting.append((place, script))
        tcp, turn = state["tcp_position"], Rotation.from_quat(state["tcp_quaternion"])
        upright = pointing_down(tool_yaw(state))
        if not waiting:
            return go(state, tcp, OPEN, upright)
        place, script = max(waiting, key=lambda one: room(one[0], [other for other, _ in waiting]))
        radius = float(np.linalg.norm(tcp[:2]))
        from_goal = any(distance(state, end) < distance(state, place) for end in reached)
        tilted = bool(reached) and -turn.apply(UP)[2] < np.cos(self.tilted)
        if (from_goal and radius > self.stretched) or (tilted and radius > self.drawn_in):
            return go(state, np.array([*(0.8 * self.drawn_in / radius * tcp[:2]), place[2] + 0.2]), OPEN, turn)
        return go(state, tcp, OPEN, upright) if tilted else script(state)


def room(place: FloatArray, places: Sequence[FloatArray]) -> float:
    """Return the horizontal distance to the nearest other one of the places (m)."""
    distances = [float(np.linalg.norm((place - other)[:2])) for other in places if other is not place]
    return min(distances, default=np.inf)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def across(state: State, quaternion: str) -> float:
    """Return the nearest yaw (rad) at which the fingers close along the y axis of an object."""
    current = tool_yaw(state)
    return current + (yaw_of(state[quaternion]) - current + np.pi / 2) % np.pi - np.pi / 2


def opened(state: State, width: float) -> bool:
    """Return whether the fingers have let go of something that is this wide (m)."""
    return float(state["finger_positions"].sum()) > width + 0.015


def gripped(state: State, place: FloatArray, width: float) -> bool:
    """Return whether the fingers hold something this wide (m) at a place."""
    return distance(state, place) < 0.03 and abs(float(state["finger_positions"].sum()) - width) < 0.012


def grasp_at(state: State, place: FloatArray, yaw: float, width: float) -> FloatArray:
    """Return one action (7,) of a grasp: open, approach the place from above within a funnel, close."""
    opening, target = float(state["finger_positions"].sum()), np.array(place)
    lateral, angle_error = float(np.linalg.norm((target - state["tcp_position"])[:2])), abs(yaw - tool_yaw(state))
    closing = distance(state, place) < 0.02 and width - 0.01 < opening < width + 0.03
    if closing or (distance(state, place) < 0.015 and angle_error < 0.2 and opening > width):
        return go(state, target, CLOSED, pointing_down(yaw))
    until_open = 0.1 if opening < width + 0.015 else 0.0
    target[2] += min(0.12, max(0.0, 5.0 * (lateral - 0.01), 0.4 * (angle_error - 0.15), until_open))
    return go(state, target, OPEN, pointing_down(yaw))


GRASPS = {"cereal": (0.03, 0.045), "milk": (0.04, 0.05), "can": (0.052, 0.015), "bread": (0.04, 0.015)}
"""Objects of PickPlace to their narrow sides and heights of the grasp (m)."""


def _pick_place() -> Script:
    goods = {(name, f"{name}_goal"): PickPlaceOver(name, *how, f"{name}_goal") for name, how in GRASPS.items()}
    return OneByOne(goods, near=(0.08, 0.1, 0.06))


def _nut_assembly() -> Script:
    pairs = [(f"{shape}_nut", f"{shape}_peg") for shape in ("square", "round")]
    return OneByOne({pair: NutAssembly(*pair) for pair in pairs}, near=(0.025, 0.025, 0.06))


BY_TASK: dict[str, Callable[[], Script]] = {
    "Lift": Lift,
    "Stack": Stack,
    "Door": Door,
    "Wipe": Wipe,
    "PickPlace": _pick_place,
    "NutAssembly": _nut_assembly,
    **{f"PickPlace{name.capitalize()}": partial(PickPlace, name, *how) for name, how in GRASPS.items()},
    "NutAssemblySquare": NutAssembly,
    "NutAssemblyRound": NutAssembly,
}


class Slower:
    """A script for the arms that follow their controllers more slowly than the Panda."""

    def __init__(self, script: Callable[[], Script]) -> None:
        """Take what makes the Panda's script."""
        self._script = script()

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,), the motion cut to `SLOWER_STEP` and `SLOWER_TURN` in each axis."""
        action = self._script(state)
        action[:3] = np.clip(action[:3], -SLOWER_STEP, SLOWER_STEP)
        action[3:6] = np.clip(action[3:6], -SLOWER_TURN, SLOWER_TURN)
        return action


def script_of(name: str, task: TaskDescription, by_task: Mapping[str, Callable[[], Script]]) -> Callable[[], Script]:
    """Return the script of a task by its name in robosuite, given the Panda's by the names before an `@`."""
    first, _, other_arm = name.partition(AT)
    if task.joints:
        return partial(ByJoints, by_task[first], BY_JOINTS_HZ if task.velocities else None)
    return partial(Slower, by_task[first]) if other_arm and task.arms == 1 else by_task[first]


def scripts_of(arms: int, by_task: Mapping[str, Callable[[], Script]]) -> dict[str, Callable[[], Script]]:
    """Return the scripts of robosuite's tasks of this number of arms; none where it is not declared."""
    simulator = simulators().get("robosuite")
    known = {name: task for name, task in (simulator.tasks.items() if simulator else ()) if task.arms == arms}
    chosen = {name: task for name, task in known.items() if name.partition(AT)[0] in by_task}
    return {f"robosuite/{name}": script_of(name, task, by_task) for name, task in chosen.items()}


SCRIPTS = scripts_of(1, BY_TASK)
