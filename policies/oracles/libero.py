"""Scripted oracles for LIBERO. They act on the current state, so they recover from any disturbance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

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
    """Distance of the grasp from the object's middle (m): a bowl is too wide and is grasped at its rim. Negative: on
    the side towards the negative y axis."""
    middle: tuple[float, float] = (0.0, 0.0)
    """Middle of the rim from the object's centre, along the object's x and y (m): a mug's centre counts its handle."""
    round: bool = False
    """Whether the object can be grasped at its middle from all sides."""
    along: float = 0.0
    """Distance from the middle, along the robot's x axis, at which the object can be grasped too (m)."""
    narrow: float = 0.002
    wide: float = 0.075
    """Smallest and largest distance between fingers that hold the object (m)."""


BOWL = Grasp(0.01, rim=0.047, wide=0.04)
GRASPS = {
    "akita_black_bowl": BOWL,
    "alphabet_soup": Grasp(0.023, round=True, narrow=0.04),
    "tomato_sauce": Grasp(0.023, round=True, narrow=0.04),
    "cream_cheese": Grasp(0.006, along=0.02, narrow=0.02),
    "butter": Grasp(0.006, along=0.02, narrow=0.02),
    "chocolate_pudding": Grasp(0.004, along=0.02, narrow=0.02),
    "salad_dressing": Grasp(0.055),
    "ketchup": Grasp(0.055),
    "bbq_sauce": Grasp(0.0365),
    "orange_juice": Grasp(0.0485),
    "milk": Grasp(0.0485),
    "wine_bottle": Grasp(0.06, narrow=0.004, wide=0.03),
    "porcelain_mug": Grasp(0.042, rim=-0.041, middle=(0.018, 0.0), wide=0.03),
    "white_yellow_mug": Grasp(0.039, rim=0.041, middle=(-0.018, 0.0), wide=0.03),
    "moka_pot": Grasp(0.07, middle=(0.0, -0.018), narrow=0.005, wide=0.03),
}


class PickAndPlace:
    """Grasps an object from above, moves it over others, lowers it and releases it."""

    def __init__(
        self,
        name: str,
        goal: str,
        *,
        rest: float,
        travel: float,
        near: float = 0.012,
        beside: tuple[float, float] = (0.0, 0.0),
        sides: Sequence[float] = (),
    ) -> None:
        """Set object and goal.

        Args:
            name: Name of the object.
            goal: Name of the object that it is put on, or `goal`.
            rest: Height of the object above the goal when it is released (m).
            travel: Height of the object above the goal while it is moved (m).
            near: Largest distance from the place at which the object is released (m).
            beside: The place from the goal's centre, along the robot's x and y (m).
            sides: Yaws of the gripper (rad) from which one is chosen, see `free_grasp`.
        """
        self._object, self._goal = name, goal
        self._beside = np.array([*beside, 0.0])
        self._grasp = GRASPS[name.rpartition("_")[0]]
        self._sides = sides or (SIDES if self._grasp.rim else TURNS if self._grasp.round else (0.0,))
        self._rest, self._travel, self._near = rest, travel, near
        self._yaw: float | None = None
        self._lever = np.zeros(3)
        self._opening = 0.0
        """Distance between the fingers in the previous step."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        if self._yaw is None:
            self._yaw, self._lever = free_grasp(state, self._object, self._middle(state), self._grasp, self._sides)
        rotation = pointing_down(self._yaw)
        grasp_point = self._grasp_point(state)
        to_goal, lateral = self._to_goal(state)
        opening = float(state["finger_positions"].sum())
        still, self._opening = abs(opening - self._opening) < STILL, opening
        tcp = state["tcp_position"]
        if self._placed(state):
            free = opening > 0.07 or np.linalg.norm(tcp - grasp_point) > 0.05
            return go(state, tcp + (0.05 * UP if free else 0.0), OPEN, rotation)
        if not (still and self._holds(state, grasp_point, opening)):
            return self._approach(state, grasp_point, opening, rotation)
        return go(state, tcp + transport(to_goal, lateral, self._travel - self._rest, self._near), CLOSED, rotation)

    def done(self, state: State) -> bool:
        """Return whether the object has been released at its place, and the gripper is off it."""
        off = np.linalg.norm(state["tcp_position"] - self._grasp_point(state)) > 0.045
        return bool(self._placed(state) and off and state["finger_positions"].sum() > 0.07)

    def _placed(self, state: State) -> bool:
        """Return whether the object is where it is released, or has fallen from there."""
        to_goal, lateral = self._to_goal(state)
        return bool((lateral < self._near + 0.01 and to_goal[2] > -0.008) or (lateral < 0.06 and to_goal[2] > 0.03))

    def _to_goal(self, state: State) -> tuple[FloatArray, float]:
        """Return the displacement (3,) of the object to where it is released, and its horizontal length (m)."""
        to_goal = state[self._goal + POSITION] + self._beside + self._rest * UP - state[self._object + POSITION]
        return to_goal, float(np.linalg.norm(to_goal[:2]))

    def _grasp_point(self, state: State) -> FloatArray:
        """Return the point (3,) of the grasp."""
        return self._middle(state) + self._lever + self._grasp.height * UP

    def _middle(self, state: State) -> FloatArray:
        """Return the middle (3,) of the object's rim, at the height of its centre."""
        centre = state[self._object + POSITION]
        if not any(self._grasp.middle):
            return centre
        return centre + Rotation.from_quat(state[f"{self._object}_quaternion"]).apply([*self._grasp.middle, 0.0])

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

    def done(self, state: State) -> bool:
        """Return whether the knob is turned and the gripper above it."""
        above = state["tcp_position"][2] - state[self._knob + POSITION][2] - self.height
        return bool(state[self._knob][0] > self._angle and above > 0.06)

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
            ahead = pointing_down(yaw + min(0.4, self._angle + 0.3 - turned))
            return go(state, ridge, CLOSED, ahead)
        if lateral < 0.012 and above < 0.012 and angle_error < 0.2:
            return go(state, ridge, CLOSED, rotation)
        until_open = 0.06 if opening < 0.06 else 0.0
        back = min(OVER, max(0.0, 5.0 * (lateral - 0.01), 0.4 * (angle_error - 0.15), until_open))
        return go(state, ridge + back * UP, OPEN, rotation)


class PushDrawer:
    """Pushes a drawer shut by its handle. The gripper is tilted, so that the palm does not touch the handle above."""

    tilt = np.radians(25.0)
    """Angle of the gripper from pointing down towards the drawer (rad)."""

    def __init__(self, drawer: str, handle: tuple[float, float, float]) -> None:
        """Take the drawer's body and its handle in the body's frame (m); the drawer is shut along the body's y axis."""
        self._drawer, self._handle = drawer, handle

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        drawer = Rotation.from_quat(state[f"{self._drawer}_quaternion"])
        handle = state[self._drawer + POSITION] + drawer.apply(self._handle) + 0.01 * UP
        rotation = drawer * Rotation.from_euler("x", self.tilt) * pointing_down(np.pi / 2)
        offset = drawer.inv().apply(state["tcp_position"] - handle)
        if abs(offset[0]) < 0.03 and abs(offset[2]) < 0.015 and -0.09 < offset[1] < 0.0:
            return go(state, handle + drawer.apply([0.0, 0.06, 0.0]), CLOSED, rotation)
        start = handle + drawer.apply([0.0, -0.07, 0.0])
        lateral = float(np.linalg.norm((state["tcp_position"] - start)[:2]))
        return go(state, start + min(OVER, max(0.0, 5.0 * (lateral - 0.01))) * UP, CLOSED, rotation)


class InTurn:
    """Plays scripts one after the other, each until it is done."""

    def __init__(self, *first: PickAndPlace | TurnKnob, last: Script) -> None:
        """Take the scripts; the last one goes on."""
        self._first, self._last = list(first), last

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        while self._first and self._first[0].done(state):
            self._first.pop(0)
        return self._first[0](state) if self._first else self._last(state)


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


def free_grasp(
    state: State, name: str, middle: FloatArray, grasp: Grasp, sides: Sequence[float]
) -> tuple[float, FloatArray]:
    """Return the yaw (rad) of `sides` at which the gripper is farthest from other objects, and where it grasps.

    The fingers are in the directions (-sin, cos) of the yaw and opposite. The place of the grasp (3,) is relative to
    the object's middle (3,).
    """
    ignored = (name + POSITION, "tcp_position", "goal_position")
    others = [
        position - middle
        for key, position in state.items()
        if key.endswith(POSITION) and key not in ignored and np.shape(position) == (3,)
    ]

    def clearance(choice: tuple[float, FloatArray]) -> float:
        yaw, lever = choice
        fingers = np.array([-np.sin(yaw), np.cos(yaw)])
        if grasp.rim:
            tip = np.copysign(0.1, grasp.rim) * fingers
            beyond = max(0.0, float(np.linalg.norm(middle[:2] + tip)) - REACH)
            nearest = min((float(np.linalg.norm(tip - other[:2])) for other in others), default=1.0)
            return min(nearest, 0.15) - 0.01 * abs(yaw) - 3.0 * beyond
        gap = min((gap_beside(other - lever, fingers) for other in others), default=1.0)
        return min(gap, 0.01) - 0.01 * abs(yaw) - 0.1 * float(np.linalg.norm(lever))

    levers = {yaw: grasp.rim * np.array([-np.sin(yaw), np.cos(yaw), 0.0]) for yaw in sides}
    shifts = (0.0, grasp.along, -grasp.along) if grasp.along else (0.0,)
    return max(((yaw, levers[yaw] + [shift, 0.0, 0.0]) for yaw in sides for shift in shifts), key=clearance)


def gap_beside(other: FloatArray, fingers: FloatArray) -> float:
    """Return the distance (m) between a gripper and an object at `other` (3,), relative to the grasp.

    The hand is 20 cm long in the direction (2,) of the fingers and 6 cm thick, and above low objects; the open fingers
    are 11 cm apart. Objects are taken to be 7 cm wide.
    """
    half, thick = (0.1, 0.065) if other[2] > 0.02 else (0.055, 0.045)
    along, across = float(fingers @ other[:2]), float(fingers[0] * other[1] - fingers[1] * other[0])
    return float(np.hypot(max(abs(along) - half, 0.0), across)) - thick


REACH = 0.8
"""Distance from the base (m) beyond which the tool cannot point down everywhere."""
NEAR_SIDE: Sequence[float] = [np.pi / 2]
"""The yaw at which the gripper is on the robot's side of a rim, and narrow from left to right."""
TURNS: Sequence[float] = [0.0, *(sign * angle for angle in np.radians([30.0, 60.0, 90.0]) for sign in (1, -1))]
SIDES: Sequence[float] = [0.0, *(sign * angle for angle in np.radians([30.0, 60.0]) for sign in (1, -1))]


def _on_plate(travel: float = 0.15, sides: Sequence[float] = ()) -> PickAndPlace:
    return PickAndPlace("akita_black_bowl_1", "plate_1", rest=0.0325, travel=travel, sides=sides)


def _on_stove(pot: str, aside: float = 0.0) -> PickAndPlace:
    return PickAndPlace(pot, "flat_stove_1_burner", rest=0.1, travel=0.12, beside=(aside, 0.0))


def _mug(name: str, plate: str) -> PickAndPlace:
    return PickAndPlace(name, plate, rest=0.06, travel=0.15)


def _in_basket(name: str, aside: float = 0.0) -> PickAndPlace:
    """Put an object into the basket, whose rim is 7 cm above its centre, `aside` (m) along the robot's x axis."""
    low = LOW[name]
    place = f"{name}_1", "basket_1"
    return PickAndPlace(*place, rest=0.0745 + low, travel=0.0995 + low, near=0.02, beside=(aside, 0.0))


def _both_in_basket(first: str, second: str) -> InTurn:
    return InTurn(_in_basket(first, 0.03), last=_in_basket(second, -0.03))


LOW = {
    "alphabet_soup": 0.038,
    "cream_cheese": 0.009,
    "salad_dressing": 0.073,
    "bbq_sauce": 0.0535,
    "ketchup": 0.072,
    "tomato_sauce": 0.038,
    "butter": 0.009,
    "milk": 0.0655,
    "chocolate_pudding": 0.013,
    "orange_juice": 0.0655,
}
"""Height of objects' centres above their bottom (m), in the order of the tasks of `object`."""
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
BY_NAME: dict[str, Callable[[], Script]] = {
    **{f"spatial-{name}": _on_plate for name in SPATIAL},
    "spatial-4-in-top-drawer-wooden-cabinet": lambda: _on_plate(0.25, NEAR_SIDE),
    "spatial-6-next-to-cookie-box": lambda: _on_plate(sides=NEAR_SIDE),
    **{f"object-{i}-{name.replace('_', '-')}": partial(_in_basket, name) for i, name in enumerate(LOW)},
    "goal-1-put-bowl-on-stove": lambda: PickAndPlace("akita_black_bowl_1", "goal", rest=0.057, travel=0.157),
    "goal-2-put-wine-bottle-on-top-cabinet": lambda: PickAndPlace("wine_bottle_1", "goal", rest=0.083, travel=0.12),
    "goal-4-put-bowl-on-top-cabinet": lambda: PickAndPlace("akita_black_bowl_1", "goal", rest=0.037, travel=0.087),
    "goal-6-put-cream-cheese-in-bowl": lambda: PickAndPlace("cream_cheese_1", "goal", rest=0.055, travel=0.12),
    "goal-7-turn-on-stove": lambda: TurnKnob("flat_stove_1_button", 0.6),
    "goal-8-put-bowl-on-plate": _on_plate,
    "10-0-livingroom2-put-both-alphabet-soup-tomato-sauce-in-basket": lambda: _both_in_basket(
        "alphabet_soup", "tomato_sauce"
    ),
    "10-1-livingroom2-put-both-cream-cheese-box-butter-in-basket": lambda: _both_in_basket("cream_cheese", "butter"),
    "10-2-kitchen3-turn-on-stove-put-moka-pot-on": lambda: InTurn(
        TurnKnob("flat_stove_1_button", 0.6), last=_on_stove("moka_pot_1")
    ),
    "10-3-kitchen4-put-black-bowl-in-bottom-drawer-cabinet-close": lambda: InTurn(
        PickAndPlace(
            "akita_black_bowl_1", "goal", rest=0.02, travel=0.12, near=0.015, beside=(0.0, -0.03), sides=NEAR_SIDE
        ),
        last=PushDrawer("white_cabinet_1_cabinet_bottom", (-0.003, -0.102, 0.041)),
    ),
    "10-4-livingroom5-put-white-mug-on-left-plate-put-yellow-white-mug-on-right-plate": lambda: InTurn(
        _mug("porcelain_mug_1", "plate_1"), last=_mug("white_yellow_mug_1", "plate_2")
    ),
    "10-6-livingroom6-put-white-mug-on-plate-put-chocolate-pudding-to-right-plate": lambda: InTurn(
        PickAndPlace("chocolate_pudding_1", "plate_1", rest=0.02, travel=0.1, beside=(0.0, 0.11)),
        last=_mug("porcelain_mug_1", "plate_1"),
    ),
    "10-7-livingroom1-put-both-alphabet-soup-cream-cheese-box-in-basket": lambda: _both_in_basket(
        "alphabet_soup", "cream_cheese"
    ),
    "10-8-kitchen8-put-both-moka-pots-on-stove": lambda: InTurn(
        _on_stove("moka_pot_1", -0.042), last=_on_stove("moka_pot_2", 0.042)
    ),
}
SCRIPTS: dict[str, Callable[[], Script]] = {
    f"libero/{pro}{name}": script for pro in ("", "pro-language-", "pro-swap-") for name, script in BY_NAME.items()
}
