"""Scripted oracles for LIBERO. Each decides from the state alone what to do next, so it also recovers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, move, pointing_down, yaw_of

MAX_STEP, MAX_TURN = 0.0131, 0.118
"""Longest motion in one step (m, rad): what the controller can do."""
GAIN = 0.262
"""Share of the remaining way in one step: the most that this controller follows without overshooting."""
UP = np.array([0.0, 0.0, 1.0])
POSITION = "_position"
STILL = 0.002
"""Fingers that move by less than this in a step have met something (m)."""
OVER = 0.15
"""Height above a grasp (m) at which the open gripper passes over whatever else stands there."""


@dataclass(frozen=True)
class Grasp:
    """How a thing is taken, from above."""

    height: float
    """Of the tool centre point above the thing's own (m). The palm is 2 cm above it, the fingertips 1.3 cm below."""
    rim: float = 0.0
    """Distance of what is grasped from the thing's middle (m): a bowl is too wide and is taken by its rim."""
    narrow: float = 0.002
    wide: float = 0.075
    """Between which the fingers are apart when they hold it (m)."""


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
    """Takes a thing from above, carries it over others, lowers it and lets go."""

    def __init__(self, thing: str, goal: str, *, rest: float, travel: float, near: float = 0.012) -> None:
        """Say what goes where.

        Args:
            thing: Name of what is taken.
            goal: Name of what it is put on, or `goal`.
            rest: Its height above the goal where it is let go (m).
            travel: Its height above the goal while it is carried (m).
            near: How far from the goal's middle it may be let go (m).
        """
        self._thing, self._goal = thing, goal
        self._grasp = GRASPS[thing.rpartition("_")[0]]
        self._rest, self._travel, self._near = rest, travel, near
        self._side: float | None = None
        self._opening = 0.0
        """How far the fingers were apart when last asked."""

    def __call__(self, state: State) -> FloatArray:
        """The next action."""
        thing = state[self._thing + POSITION]
        if self._side is None:
            self._side = free_side(state, self._thing) if self._grasp.rim else 0.0
        rotation = pointing_down(self._side)
        held_at = thing + self._lever(self._side)
        away = state[self._goal + POSITION] + self._rest * UP - thing
        aside = float(np.linalg.norm(away[:2]))
        opening = float(state["finger_positions"].sum())
        still, self._opening = abs(opening - self._opening) < STILL, opening
        tcp = state["tcp_position"]
        if aside < self._near + 0.01 and away[2] > -0.008:
            free = opening > 0.07 or np.linalg.norm(tcp - held_at) > 0.05
            return go(state, tcp + (0.05 * UP if free else 0.0), OPEN, rotation)
        if not (still and self._holds(state, held_at, opening)):
            return self._take(state, held_at, opening, rotation)
        return go(state, tcp + carried(away, aside, self._travel - self._rest, self._near), CLOSED, rotation)

    def _lever(self, yaw: float) -> FloatArray:
        """From the thing's middle to where it is grasped."""
        return np.array([-np.sin(yaw) * self._grasp.rim, np.cos(yaw) * self._grasp.rim, self._grasp.height])

    def _holds(self, state: State, held_at: FloatArray, opening: float) -> bool:
        offset = state["tcp_position"] - held_at
        close = np.linalg.norm(offset[:2]) < 0.025 and abs(offset[2]) < 0.03
        return bool(close and self._grasp.narrow < opening < self._grasp.wide - 0.003)

    def _take(self, state: State, held_at: FloatArray, opening: float, rotation: Rotation) -> FloatArray:
        """One action of opening, coming down on the thing through a funnel, and closing."""
        offset = state["tcp_position"] - held_at
        aside, above = float(np.linalg.norm(offset[:2])), abs(float(offset[2]))
        askew = (rotation * Rotation.from_quat(state["tcp_quaternion"]).inv()).magnitude()
        closing = aside < 0.02 and above < 0.02 and self._grasp.narrow < opening < 0.07
        if closing or (aside < 0.008 and above < 0.008 and askew < 0.15 and opening > self._grasp.narrow):
            return go(state, held_at, CLOSED, rotation)
        shut = 0.08 if opening < 0.07 else 0.0
        back = min(OVER, max(0.0, 5.0 * (aside - 0.008), 0.4 * (askew - 0.12), shut))
        return go(state, held_at + back * UP, OPEN, rotation)


class TurnKnob:
    """Takes the stove's knob by its ridge and turns it."""

    height = 0.032
    """Of the ridge above the stove (m)."""

    def __init__(self, knob: str, angle: float) -> None:
        """Args: knob: name of body and joint; angle: to be reached, rad."""
        self._knob, self._angle = knob, angle

    def __call__(self, state: State) -> FloatArray:
        """The next action."""
        turned = float(state[self._knob][0])
        ridge = state[self._knob + POSITION] + self.height * UP
        yaw = yaw_of(state[f"{self._knob}_quaternion"]) - np.pi / 2
        rotation = pointing_down(yaw)
        offset = state["tcp_position"] - ridge
        aside, above = float(np.linalg.norm(offset[:2])), abs(float(offset[2]))
        askew = (rotation * Rotation.from_quat(state["tcp_quaternion"]).inv()).magnitude()
        opening = float(state["finger_positions"].sum())
        if turned > self._angle:
            return go(state, state["tcp_position"] + 0.05 * UP, OPEN, rotation)
        if aside < 0.025 and above < 0.02 and opening < 0.045:
            ahead = pointing_down(yaw + min(0.4, self._angle + 0.1 - turned))
            return go(state, ridge, CLOSED, ahead)
        if aside < 0.012 and above < 0.012 and askew < 0.2:
            return go(state, ridge, CLOSED, rotation)
        shut = 0.06 if opening < 0.06 else 0.0
        back = min(OVER, max(0.0, 5.0 * (aside - 0.01), 0.4 * (askew - 0.15), shut))
        return go(state, ridge + back * UP, OPEN, rotation)


def go(state: State, target: FloatArray, gripper: float, rotation: Rotation) -> FloatArray:
    """One action towards a pose, at the pace of these oracles."""
    return move(state, target, gripper=gripper, max_step=MAX_STEP, gain=GAIN, rotation=rotation, max_turn=MAX_TURN)


def carried(away: FloatArray, aside: float, lift: float, near: float) -> FloatArray:
    """The way (3,) to carry a thing whose goal is `away`: up to `lift` above it first, then across, then down."""
    way = away.copy()
    way[2] += min(lift, max(0.0, 4.0 * (aside - near)))
    if way[2] > 0.01:  # Too low to go far.
        way[:2] *= float(np.clip(1.0 - (way[2] - 0.01) / 0.03, 0.0, 1.0))
    return way


def free_side(state: State, thing: str) -> float:
    """The yaw at which the gripper on a thing's rim is farthest from all else. Its lever points along (-sin, cos)."""
    middle = state[thing + POSITION]
    others = [
        where
        for name, where in state.items()
        if name.endswith(POSITION)
        and name not in (thing + POSITION, "tcp_position", "goal_position")
        and np.shape(where) == (3,)
    ]

    def room(yaw: float) -> float:
        tip = middle[:2] + 0.1 * np.array([-np.sin(yaw), np.cos(yaw)])
        nearest = min((float(np.linalg.norm(tip - other[:2])) for other in others), default=1.0)
        return min(nearest, 0.15) - 0.01 * abs(yaw) - 3.0 * max(0.0, float(np.linalg.norm(tip)) - REACH)

    return max(SIDES, key=room)


REACH = 0.8
"""From the base (m); farther than this the tool does not point down everywhere."""
SIDES: Sequence[float] = [0.0, *(sign * angle for angle in np.radians([30.0, 60.0]) for sign in (1, -1))]


def _on_plate() -> Script:
    return PickAndPlace("akita_black_bowl_1", "plate_1", rest=0.0325, travel=0.15)


def _in_basket(thing: str, low: float) -> Callable[[], Script]:
    """`low`: how far the thing's bottom is below its middle (m). A basket's rim is 7 cm above its own."""
    return lambda: PickAndPlace(thing, "basket_1", rest=0.0745 + low, travel=0.0995 + low, near=0.02)


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
