"""Adapters whose ball can be moved, with one violation each, see `tests.orchestrator.kit.adapter.variants`."""

import numpy as np

from robogauntlet.adapters.scene_control import PlacementRegion, SceneControls
from tests.orchestrator.kit.adapter.variants import Variant


class MovesTheBall(Variant):
    """Correct."""

    low, high = np.array([0.4, -0.12]), np.array([0.6, 0.12])

    def __init__(self, view):
        super().__init__(view)
        self.scene_controls = SceneControls(cameras=self._cameras, objects=self)

    def placeable(self):
        return {"ball": PlacementRegion(self.low, self.high)}

    def move(self, name, offset):
        self._world.ball[:2] += offset


class OnATable(MovesTheBall):
    """Correct."""

    table_height = 0.0
    table_edges = np.array([[0.2, -0.4], [1.0, 0.4]])

    def __init__(self, view):
        super().__init__(view)
        self.scene_controls = SceneControls(cameras=self._cameras, objects=self, table=self)


class TableOnTheLeft(OnATable):
    table_edges = np.array([[0.2, 0.5], [1.0, 1.3]])


class TableAbove(OnATable):
    table_height = 0.3


class TooSmallABox(MovesTheBall):
    high = np.array([0.55, 0.12])


class TooLargeABox(MovesTheBall):
    high = np.array([0.9, 0.12])


class SlidesUndeclared(MovesTheBall):
    """The ball slides by 5 cm after each reset."""

    def reset(self, seed):
        super().reset(seed)
        self._world.ball[0] += 0.05


class SlidesAsDeclared(SlidesUndeclared):
    """Correct."""

    def privileged_state(self):
        return super().privileged_state() | {"settling_shift": np.array([0.05])}


class RollsAway(MovesTheBall):
    def step(self, action):
        self._world.ball[0] += 0.002
        return super().step(action)


class HasANeighbour(MovesTheBall):
    """Correct: a wall beside the ball pushes it away where they meet."""

    wall = np.zeros(3)

    def reset(self, seed):
        super().reset(seed)
        self.wall = self._world.ball + np.array([0.05, -0.03, 0.0])

    def step(self, action):
        if np.linalg.norm(self.wall - self._world.ball) < 0.04:
            self._world.ball[0] -= 0.01
        return super().step(action)

    def privileged_state(self):
        return super().privileged_state() | {"wall_position": self.wall.copy()}
