"""Sets mass and friction of the cube, the only movable object of panda-gym's tasks."""

from __future__ import annotations

from typing import Any

from robogauntlet.adapters.scene_control import DynamicsFactors

BASE_LINK = -1


class PyBulletDynamics:
    """`BodyDynamics` of `scene_control`. PyBullet multiplies the two coefficients of a contact."""

    def __init__(self, client: Any, cube: int) -> None:
        """Take a physics server and its cube."""
        self._client, self._cube = client, cube
        self._original = self._read()

    def undo(self) -> None:
        """Restore mass and friction."""
        if self._read() != self._original:
            self.set_dynamics(DynamicsFactors())

    def dynamics(self) -> DynamicsFactors:
        """Return the present factors, from PyBullet."""
        (mass, friction), (own_mass, own_friction) = self._read(), self._original
        return DynamicsFactors(mass / own_mass, friction / own_friction)

    def set_dynamics(self, dynamics: DynamicsFactors) -> None:
        """Scale mass and friction, until the next reset. PyBullet sets the inertia."""
        mass, friction = self._original
        self._client.changeDynamics(
            self._cube, BASE_LINK, mass=dynamics.mass * mass, lateralFriction=dynamics.friction * friction
        )

    def _read(self) -> tuple[float, float]:
        mass, friction, *_ = self._client.getDynamicsInfo(self._cube, BASE_LINK)
        return mass, friction
