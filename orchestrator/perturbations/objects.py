"""Things where no reset would put them, and things that are heavier and more or less slippery."""

from __future__ import annotations

import numpy as np

from adapters.adjusting import Bodies, Dynamics, Objects, Placeable
from adapters.contract import Delivered, FloatArray, UnsupportedCondition
from orchestrator.perturbations.base import Perturbed
from suites.operators import generator_for
from suites.vocabulary import Condition

CLEAR = 0.06
"""How far a displaced thing must be from the others (m, centre to centre)."""
FROM_GOAL = 0.15
"""How far it must be from the goal, unless it is nearer in the clean episode (m): PushCube's target is 0.1 m wide."""
POSITION = "_position"


class Displaced(Perturbed):
    """The thing that the task is about, outside the region of its resets."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the clean episode, then move the thing.

        Raises:
            UnsupportedCondition: Nothing can be moved here, or there is no free place.
        """
        super().reset(seed, condition)
        objects: Objects = self.offered(self.adjusters.objects, "things be moved")
        self._name, self._box = next(iter(objects.placeable().items()))
        state = self.simulation.privileged_state()
        own = state[self._name + POSITION][:2]
        others = [
            where[:2] for name, where in state.items() if name.endswith(POSITION) and name not in self._not_in_way
        ]
        generator = generator_for(self.episode.pair_id, 0)
        for place in generator.permutation(beside(self._box, own, self.level / 100)):
            if self._name != "goal" and _is_nearer(place, own, state.get("goal_position")):
                continue
            if all(np.linalg.norm(place - other) >= CLEAR for other in others):
                objects.move(self._name, place - own)
                self._position = self.simulation.privileged_state()[self._name + POSITION][:2]
                return
        raise UnsupportedCondition(f"{self.episode.condition}: something else lies at each place for {self._name}")

    @property
    def _not_in_way(self) -> tuple[str, ...]:
        """What a thing may be near: itself, where it is to go, and what is measured on it."""
        return (
            self._name + POSITION,
            "goal_position",
            "tcp_position",
            "finger_positions",
            "handle_position",
            "latch_position",
        )

    def delivered(self) -> Delivered | None:
        """How far from the region it was put (cm)."""
        return Delivered(self.checked(100 * outside(self._box, self._position)))


class Altered(Perturbed):
    """Things of other mass and friction."""

    def reset(self, seed: int, condition: Condition) -> None:
        """Start the clean episode, then change the things.

        Raises:
            UnsupportedCondition: This simulation's things cannot be changed.
        """
        super().reset(seed, condition)
        self._bodies: Bodies = self.offered(self.adjusters.bodies, "masses and frictions be changed")
        slippery = generator_for(self.episode.pair_id, 0).random() < 0.5
        self._bodies.set_dynamics(Dynamics(self.level, 1 / self.also if slippery else self.also))
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


def beside(box: Placeable, point: FloatArray, distance: float) -> FloatArray:
    """The four places (4, 2) beyond the sides of a box, straight across from a point (2,) within it."""
    places = np.tile(point, (4, 1))
    for axis in range(2):
        places[2 * axis, axis] = box.low[axis] - distance
        places[2 * axis + 1, axis] = box.high[axis] + distance
    return places


def outside(box: Placeable, point: FloatArray) -> float:
    """Distance (m) of a point (2,) from a box; 0 within."""
    return float(np.linalg.norm(np.maximum(0.0, np.maximum(box.low - point, point - box.high))))
