"""Perturbed physics: other start positions of objects and robot, other mass and friction."""

from __future__ import annotations

import math

import numpy as np

from robogauntlet.adapters.contract import Delivered, FloatArray, UnsupportedCondition, is_of_second_arm
from robogauntlet.adapters.scene_control import DynamicsFactors, PlacementRegion, Unreachable, unit
from robogauntlet.orchestrator.perturbations.base import Perturbed

CLEARANCE = 0.06
"""Smallest distance of a displaced object from the others (m, centre to centre)."""
FROM_GOAL = 0.15
"""Smallest distance from the goal, unless it is nearer in the clean episode (m): PushCube's target is 0.1 m wide."""
POSITION = "_position"
MIN_HEIGHT = 0.03
"""Smallest height of the tool above the table (m)."""
DRAWS = 200


class ObjectPosition(Perturbed):
    """The task's object, outside the region in which resets place it."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then move the object.

        Raises:
            UnsupportedCondition: No object can be moved, or there is no free place.
        """
        super().reset(seed)
        objects = self._required(self.scene_controls.objects, "things be moved")
        self._name, self._region = next(iter(objects.placeable().items()))
        state = self.simulation.privileged_state()
        own = state[self._name + POSITION][:2]
        # It may be near itself, the goal and the tool.
        ignored = {name + POSITION for name in (self._name, *self._region.attached, "goal", "tcp")}
        others = [
            where[:2]
            for name, where in state.items()
            if name.endswith(POSITION) and not is_of_second_arm(name) and name not in ignored
        ]
        for place in self.generator.permutation(_places_around(self._region, own, self.level / 100)):
            if self._name != "goal" and _is_nearer(place, own, state.get("goal_position")):
                continue
            if all(np.linalg.norm(place - other) >= CLEARANCE for other in others):
                objects.move(self._name, place - own)
                self._position = self.simulation.privileged_state()[self._name + POSITION][:2]
                return
        raise UnsupportedCondition(f"{self.episode.condition}: something else lies at each place for {self._name}")

    def delivered(self) -> Delivered:
        """The distance of the object from the region (cm)."""
        return Delivered(self._checked(100 * distance_from(self._region, self._position)))


class Resampled(Perturbed):
    """A start that is none of the benchmark's stored states."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then one with everything placed anew.

        Raises:
            UnsupportedCondition: This simulation has no stored states, or no rules to place things by.
        """
        super().reset(seed)
        starts = self._required(self.scene_controls.starts, "things be placed anew")
        before = self.simulation.privileged_state()
        starts.resample(seed)
        after = self.simulation.privileged_state()
        moved = [np.linalg.norm((after[name] - before[name])[:2]) for name in after if name.endswith(POSITION)]
        self._moved = float(100 * max(moved))

    def delivered(self) -> Delivered:
        """The largest distance of anything from where the stored state has it, in the plane (`moved`, cm)."""
        return Delivered(None, {"moved": self._moved})


class Dynamics(Perturbed):
    """Objects of other mass and friction."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then change the objects.

        Raises:
            UnsupportedCondition: This simulation's objects cannot be changed.
        """
        super().reset(seed)
        dynamics = self._required(self.scene_controls.dynamics, "masses and frictions be changed")
        slippery = self.generator.random() < 0.5
        friction = 1 / self.secondary_level if slippery else self.secondary_level
        dynamics.set_dynamics(DynamicsFactors(self.level, friction))
        self._factors = dynamics.dynamics()

    def delivered(self) -> Delivered:
        """The factors, as the simulator reads them back."""
        return Delivered(self._checked(self._factors.mass), {"friction": self._factors.friction})


class RobotStart(Perturbed):
    """The tool at another start position, and turned."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then move the arm to the first of many drawn poses that it can reach.

        Raises:
            UnsupportedCondition: This simulation's arm cannot be moved.
            NotDelivered: It can reach none of the poses.
        """
        from scipy.spatial.transform import Rotation  # slow, and not every worker needs it

        super().reset(seed)
        arm = self._required(self.scene_controls.arm, "the arm start elsewhere")
        before = self.simulation.privileged_state()
        lowest = self.scene_controls.table.table_height + MIN_HEIGHT if self.scene_controls.table else -math.inf
        own = Rotation.from_quat(before["tcp_quaternion"])
        for _ in range(DRAWS):
            position = before["tcp_position"] + self.level / 100 * unit(self.generator.standard_normal(3))
            turn = Rotation.from_rotvec(math.radians(self.secondary_level) * unit(self.generator.standard_normal(3)))
            if position[2] < lowest:
                continue
            try:
                arm.place_tool(position, (turn * own).as_quat())
            except Unreachable:
                continue
            after = self.simulation.privileged_state()
            self._distance = float(100 * np.linalg.norm(after["tcp_position"] - before["tcp_position"]))
            self._turned = math.degrees((Rotation.from_quat(after["tcp_quaternion"]) * own.inv()).magnitude())
            return
        raise self._not_delivered(f"expected a start that the arm can reach, {DRAWS} were out of reach")

    def delivered(self) -> Delivered:
        """The distance of the tool from its own start (cm), and its rotation (deg)."""
        return Delivered(self._checked(self._distance), {"turned": self._turned})


def _is_nearer(place: FloatArray, own: FloatArray, goal: FloatArray | None) -> bool:
    """Whether a place nearly solves the task: nearer to the goal than `FROM_GOAL` and than the clean episode's."""
    if goal is None:
        return False
    distance, clean = (float(np.linalg.norm(point - goal[:2])) for point in (place, own))
    return distance < min(clean, FROM_GOAL)


def _places_around(region: PlacementRegion, point: FloatArray, distance: float) -> FloatArray:
    """The four places (4, 2) at a distance (m) from the sides of a region, straight across from a point (2,) in it."""
    places = np.tile(point, (4, 1))
    for axis in range(2):
        places[2 * axis, axis] = region.low[axis] - distance
        places[2 * axis + 1, axis] = region.high[axis] + distance
    return places


def distance_from(region: PlacementRegion, point: FloatArray) -> float:
    """Distance (m) of a point (2,) from a region; 0 inside."""
    return float(np.linalg.norm(np.maximum(0.0, np.maximum(region.low - point, point - region.high))))
