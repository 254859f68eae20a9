"""Things where no reset would put them, and things that are heavier and more or less slippery."""

from __future__ import annotations

import numpy as np

from robogauntlet.adapters.contract import Delivered, FloatArray, UnsupportedCondition
from robogauntlet.adapters.scene_control import BodyDynamics, DynamicsFactors, Objects, PlacementRegion
from robogauntlet.orchestrator.perturbations.base import Perturbed

CLEAR = 0.06
"""How far a displaced thing must be from the others (m, centre to centre)."""
FROM_GOAL = 0.15
"""How far it must be from the goal, unless it is nearer in the clean episode (m): PushCube's target is 0.1 m wide."""
POSITION = "_position"


class ObjectPosition(Perturbed):
    """The thing that the task is about, outside the region of its resets."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then move the thing.

        Raises:
            UnsupportedCondition: Nothing can be moved here, or there is no free place.
        """
        super().reset(seed)
        objects: Objects = self.offered(self.scene_controls.objects, "things be moved")
        self._name, self._box = next(iter(objects.placeable().items()))
        state = self.simulation.privileged_state()
        own = state[self._name + POSITION][:2]
        # It may be near itself, the goal and the tool.
        ignored = {name + POSITION for name in (self._name, *self._box.attached, "goal", "tcp")}
        others = [where[:2] for name, where in state.items() if name.endswith(POSITION) and name not in ignored]
        for place in self.generator.permutation(beside(self._box, own, self.level / 100)):
            if self._name != "goal" and _is_nearer(place, own, state.get("goal_position")):
                continue
            if all(np.linalg.norm(place - other) >= CLEAR for other in others):
                objects.move(self._name, place - own)
                self._position = self.simulation.privileged_state()[self._name + POSITION][:2]
                return
        raise UnsupportedCondition(f"{self.episode.condition}: something else lies at each place for {self._name}")

    def delivered(self) -> Delivered | None:
        """How far from the region it was put (cm)."""
        return Delivered(self.checked(100 * outside(self._box, self._position)))


class Dynamics(Perturbed):
    """Things of other mass and friction."""

    def reset(self, seed: int) -> None:
        """Start the clean episode, then change the things.

        Raises:
            UnsupportedCondition: This simulation's things cannot be changed.
        """
        super().reset(seed)
        self._bodies: BodyDynamics = self.offered(self.scene_controls.bodies, "masses and frictions be changed")
        slippery = self.generator.random() < 0.5
        self._bodies.set_dynamics(
            DynamicsFactors(self.level, 1 / self.secondary_level if slippery else self.secondary_level)
        )
        self._found = self._bodies.dynamics()

    def delivered(self) -> Delivered | None:
        """The factors, as the simulator reads them back."""
        return Delivered(self.checked(self._found.mass), {"friction": self._found.friction})


def _is_nearer(place: FloatArray, own: FloatArray, goal: FloatArray | None) -> bool:
    """Whether a place is so near the goal that the task is all but done, and nearer than in the clean episode."""
    if goal is None:
        return False
    distance, clean = (float(np.linalg.norm(point - goal[:2])) for point in (place, own))
    return distance < min(clean, FROM_GOAL)


def beside(box: PlacementRegion, point: FloatArray, distance: float) -> FloatArray:
    """The four places (4, 2) beyond the sides of a box, straight across from a point (2,) within it."""
    places = np.tile(point, (4, 1))
    for axis in range(2):
        places[2 * axis, axis] = box.low[axis] - distance
        places[2 * axis + 1, axis] = box.high[axis] + distance
    return places


def outside(box: PlacementRegion, point: FloatArray) -> float:
    """Distance (m) of a point (2,) from a box; 0 within."""
    return float(np.linalg.norm(np.maximum(0.0, np.maximum(box.low - point, point - box.high))))
