"""Scripted oracles for LIBERO. They act on the current state, so they recover from any disturbance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, move, pointing_down, yaw_of

MAX_STEP, MAX_TURN = 0.0131, 0.118
"""Largest motion in one step (m, rad), the controller's limit."""
GAIN = 0.262
"""Share of the remaining distance in one step, the largest that this controller follows without overshoot."""
UP = np.array([0.0, 0.0, 1.0])
POSITION = "_position"
STILL = 0.002
"""Motion of the fingers in one step below which they are blocked or at rest (m)."""
OVER = 0.15
"""Height above a grasp (m) at which the open gripper passes over other objects."""


@dataclass(frozen=True)
class Grasp:
    """A grasp of an object from above."""

    height: float
    """Height of the tool centre point above the object's centre (m). The palm is 2 cm above the tool centre point, the
    fingertips are 1.3 cm below."""
    rim: float = 0.0
    """Distance of the grasp from the object's centre (m): a bowl is too wide and is grasped at its rim."""
    narrow: float = 0.002
    wide: float = 0.075
    """Smallest and largest distance between fingers that hold the object (m)."""


BOWL = Grasp(0.01, rim=0.047, wide=0.04)
GRASPS = {
    "akita_black_bowl": BOWL,
    "alphabet_soup": Grasp(0.023, narrow=0.04),
    "tomato_sauce": Grasp(0.023, narrow=0.04),
    "cream_cheese": Grasp(0.006, narrow=0.02),
    "butter": Grasp(0.006, narrow=0.02),
    "chocolate_pudding": Grasp(0.004, narrow=0.02),
    "salad_dressing": Grasp(0.055),
    "ketchup": Grasp(0.055),
    "bbq_sauce": Grasp(0.0365),
    "orange_juice": Grasp(0.0485),
}


class PickAndPlace:
    """Grasps an object from above, moves it over others, lowers it and releases it."""

    def __init__(self, name: str, goal: str, *, rest: float, travel: float, near: float = 0.012) -> None:
        """Set object and goal.

        Args:
            name: Name of the object.
            goal: Name of the object that it is put on, or `goal`.
            rest: Height of the object above the goal when it is released (m).
            travel: Height of the object above the goal while it is moved (m).
            near: Largest distance from the goal's centre at which the object is released (m).
        """
        self._object, self._goal = name, goal
        self._grasp = GRASPS[name.rpartition("_")[0]]
        self._rest, self._travel, self._near = rest, travel, near
        self._side: float | None = None
        self._opening = 0.0
        """Distance between the fingers in the previous step."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        centre = state[self._object + POSITION]
        if self._side is None:
            self._side = free_side(state, self._object) if self._grasp.rim else 0.0
        rotation = pointing_down(self._side)
        grasp_point = centre + self._lever(self._side)
        to_goal = state[self._goal + POSITION] + self._rest * UP - centre
        lateral = float(np.linalg.norm(to_goal[:2]))
        opening = float(state["finger_positions"].sum())
        still, self._opening = abs(opening - self._opening) < STILL, opening
        tcp = state["tcp_position"]
        if lateral < self._near + 0.01 and to_goal[2] > -0.008:
            free = opening > 0.07 or np.linalg.norm(tcp - grasp_point) > 0.05
            return go(state, tcp + (0.05 * UP if free else 0.0), OPEN, rotation)
        if not (still and self._holds(state, grasp_point, opening)):
            return self._approach(state, grasp_point, opening, rotation)
        return go(state, tcp + transport(to_goal, lateral, self._travel - self._rest, self._near), CLOSED, rotation)

    def _lever(self, yaw: float) -> FloatArray:
        """Return the vector from the object's centre to the grasp point."""
        return np.array([-np.sin(yaw) * self._grasp.rim, np.cos(yaw) * self._grasp.rim, self._grasp.height])

    def _holds(self, state: State, grasp_point: FloatArray, opening: float) -> bool:
        offset = state["tcp_position"] - grasp_point
        close = np.linalg.norm(offset[:2]) < 0.025 and abs(offset[2]) < 0.03
        return bool(close and self._grasp.narrow < opening < self._grasp.wide - 0.003)

    def _approach(self, state: State, grasp_point: FloatArray, opening: float, rotation: Rotation) -> FloatArray:
        """Return one action (7,) of a grasp: open, approach from above within a funnel, close."""
        offset = state["tcp_position"] - grasp_point
        lateral, above = float(np.linalg.norm(offset[:2])), abs(float(offset[2]))
        angle_error = (rotation * Rotation.from_quat(state["tcp_quaternion"]).inv()).magnitude()
        closing = lateral < 0.02 and above < 0.02 and self._grasp.narrow < opening < 0.07
        if closing or (lateral < 0.008 and above < 0.008 and angle_error < 0.15 and opening > self._grasp.narrow):
            return go(state, grasp_point, CLOSED, rotation)
        until_open = 0.08 if opening < 0.07 else 0.0
        back = min(OVER, max(0.0, 5.0 * (lateral - 0.008), 0.4 * (angle_error - 0.12), until_open))
        return go(state, grasp_point + back * UP, OPEN, rotation)


class TurnKnob:
    """Grasps the stove's knob by its ridge and turns it."""

    height = 0.032
    """Height of the ridge above the stove (m)."""

    def __init__(self, knob: str, angle: float) -> None:
        """Turn the body and joint of this name to an angle (rad)."""
        self._knob, self._angle = knob, angle

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        turned = float(state[self._knob][0])
        ridge = state[self._knob + POSITION] + self.height * UP
        yaw = yaw_of(state[f"{self._knob}_quaternion"]) - np.pi / 2
        rotation = pointing_down(yaw)
        offset = state["tcp_position"] - ridge
        lateral, above = float(np.linalg.norm(offset[:2])), abs(float(offset[2]))
        angle_error = (rotation * Rotation.from_quat(state["tcp_quaternion"]).inv()).magnitude()
        opening = float(state["finger_positions"].sum())
        if turned > self._angle:
            return go(state, state["tcp_position"] + 0.05 * UP, OPEN, rotation)
        if lateral < 0.025 and above < 0.02 and opening < 0.045:
            ahead = pointing_down(yaw + min(0.4, self._angle + 0.1 - turned))
            return go(state, ridge, CLOSED, ahead)
        if lateral < 0.012 and above < 0.012 and angle_error < 0.2:
            return go(state, ridge, CLOSED, rotation)
        until_open = 0.06 if opening < 0.06 else 0.0
        back = min(OVER, max(0.0, 5.0 * (lateral - 0.01), 0.4 * (angle_error - 0.15), until_open))
        return go(state, ridge + back * UP, OPEN, rotation)


def go(state: State, target: FloatArray, gripper: float, rotation: Rotation) -> FloatArray:
    """Return one action (7,) towards a pose, within these oracles' limits."""
    return move(state, target, gripper=gripper, max_step=MAX_STEP, gain=GAIN, rotation=rotation, max_turn=MAX_TURN)


def transport(to_goal: FloatArray, lateral: float, lift: float, near: float) -> FloatArray:
    """Return the next displacement (3,) of a held object: up to `lift` above the goal, then across, then down."""
    displacement = to_goal.copy()
    displacement[2] += min(lift, max(0.0, 4.0 * (lateral - near)))
    if displacement[2] > 0.01:  # too low to move across
        displacement[:2] *= float(np.clip(1.0 - (displacement[2] - 0.01) / 0.03, 0.0, 1.0))
    return displacement


def free_side(state: State, name: str) -> float:
    """Return the yaw (rad) at which a gripper at an object's rim is farthest from other objects.

    The gripper is in direction (-sin, cos) from the object's centre.
    """
    centre = state[name + POSITION]
    ignored = (name + POSITION, "tcp_position", "goal_position")
    others = [
        position
        for key, position in state.items()
        if key.endswith(POSITION) and key not in ignored and np.shape(position) == (3,)
    ]

    def clearance(yaw: float) -> float:
        tip = centre[:2] + 0.1 * np.array([-np.sin(yaw), np.cos(yaw)])
        nearest = min((float(np.linalg.norm(tip - other[:2])) for other in others), default=1.0)
        return min(nearest, 0.15) - 0.01 * abs(yaw) - 3.0 * max(0.0, float(np.linalg.norm(tip)) - REACH)

    return max(SIDES, key=clearance)


REACH = 0.8
"""Distance from the base (m) beyond which the tool cannot point down everywhere."""
SIDES: Sequence[float] = [0.0, *(sign * angle for angle in np.radians([30.0, 60.0]) for sign in (1, -1))]


def _on_plate() -> Script:
    return PickAndPlace("akita_black_bowl_1", "plate_1", rest=0.0325, travel=0.15)


def _in_basket(name: str, low: float) -> Callable[[], Script]:
    """Put an object, its bottom `low` (m) below its centre, into the basket, whose rim is 7 cm above its centre."""
    return lambda: PickAndPlace(name, "basket_1", rest=0.0745 + low, travel=0.0995 + low, near=0.02)


SPATIAL = (
    "0-between-plate-ramekin",
    "1-next-to-ramekin",
    "2-from-table-center",
    "3-on-cookie-box",
    "5-on-ramekin",
    "7-on-stove",
    "8-next-to-plate",
    "9-on-wooden-cabinet",
)
OBJECTS = {
    "0-alphabet-soup": 0.038,
    "2-salad-dressing": 0.073,
    "3-bbq-sauce": 0.0535,
    "4-ketchup": 0.072,
    "5-tomato-sauce": 0.038,
    "6-butter": 0.009,
    "8-chocolate-pudding": 0.013,
    "9-orange-juice": 0.0655,
}
BY_NAME: dict[str, Callable[[], Script]] = {
    **{f"spatial-{name}": _on_plate for name in SPATIAL},
    **{f"object-{name}": _in_basket(f"{name[2:].replace('-', '_')}_1", low) for name, low in OBJECTS.items()},
    "goal-1-put-bowl-on-stove": lambda: PickAndPlace("akita_black_bowl_1", "goal", rest=0.057, travel=0.157),
    "goal-4-put-bowl-on-top-cabinet": lambda: PickAndPlace("akita_black_bowl_1", "goal", rest=0.037, travel=0.087),
    "goal-6-put-cream-cheese-in-bowl": lambda: PickAndPlace("cream_cheese_1", "goal", rest=0.055, travel=0.12),
    "goal-7-turn-on-stove": lambda: TurnKnob("flat_stove_1_button", 0.7),
    "goal-8-put-bowl-on-plate": _on_plate,
}
SCRIPTS: dict[str, Callable[[], Script]] = {f"libero/{name}": script for name, script in BY_NAME.items()}
