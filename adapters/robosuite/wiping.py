"""The dirt of robosuite's Wipe, which is drawn on the table and vanishes under the tool."""

from __future__ import annotations

from typing import Any

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics


class Dirt:
    """The spots that are to be wiped off, in the order in which a line of them is drawn."""

    def __init__(self, physics: MujocoPhysics, env: Any) -> None:
        """Take robosuite's environment, of which a reset places the spots."""
        self._physics, self._env = physics, env
        self._spots = [physics.data.body(marker.root_body) for marker in env.model.mujoco_arena.markers]

    def draw_from(self, generator: np.random.Generator) -> None:
        """Have the next reset place the spots by this generator."""
        self._env.model.mujoco_arena.rng = generator

    def wiped(self) -> FloatArray:
        """Return whether each spot is wiped off, 1.0 or 0.0, (spots,)."""
        wiped = set(map(id, self._env.wiped_markers))
        return np.array([float(id(marker) in wiped) for marker in self._env.model.mujoco_arena.markers])

    def wipe(self) -> float:
        """Wipe off what is under the tool, and return the share of all spots that are wiped off."""
        self._env.reward(None)  # It does both, as in a step of robosuite's.
        return len(self._env.wiped_markers) / len(self._spots)

    def state(self) -> dict[str, FloatArray]:
        """Return the spots in the base frame, (spots, 3) (m), and which are wiped off, (spots,)."""
        places = np.array([self._physics.from_world(spot.xpos) for spot in self._spots])
        return {"dirt_places": places, "dirt_wiped": self.wiped()}
