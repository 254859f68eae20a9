"""Mass and friction of the cube, the one thing of panda-gym's tasks that can be moved."""

from __future__ import annotations

from typing import Any

from adapters.adjusting import Dynamics

BASE_LINK = -1


class PyBulletBodies:
    """See `adapters.adjusting.Bodies`. PyBullet multiplies the two coefficients of a contact."""

    def __init__(self, client: Any, cube: int) -> None:
        """Of a physics server and its cube, as panda-gym made it."""
        self._client, self._cube = client, cube
        self._own = self._now()

    def undo(self) -> None:
        """Give the cube its own mass and friction back."""
        if self._now() != self._own:
            self.set_dynamics(Dynamics())

    def dynamics(self) -> Dynamics:
        """The factors, from what PyBullet has now."""
        (mass, friction), (own_mass, own_friction) = self._now(), self._own
        return Dynamics(mass / own_mass, friction / own_friction)

    def set_dynamics(self, dynamics: Dynamics) -> None:
        """Give the cube another mass, for which PyBullet sets the inertia, and friction, until the next reset."""
        mass, friction = self._own
        self._client.changeDynamics(
            self._cube, BASE_LINK, mass=dynamics.mass * mass, lateralFriction=dynamics.friction * friction
        )

    def _now(self) -> tuple[float, float]:
        mass, friction, *_ = self._client.getDynamicsInfo(self._cube, BASE_LINK)
        return mass, friction
