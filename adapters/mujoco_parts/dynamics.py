"""Sets mass and friction of a task's objects."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.scene_control import DynamicsFactors

MASSES = ("body_mass", "body_inertia", "body_subtreemass", "dof_M0")
"""Arrays that are proportional to the mass."""
COMPLIANCES = ("body_invweight0", "dof_invweight0")
"""Arrays inversely proportional to it. MuJoCo scales contacts by these and computes them only for a new model."""
SLIDING = 0
"""Index of sliding friction among a shape's coefficients."""
CHANGED = (*MASSES, *COMPLIANCES, "geom_friction")


class MujocoDynamics:
    """`BodyDynamics` of `scene_control`.

    A contact in MuJoCo takes the larger of two frictions: those of all bodies are scaled, so that the contact's is.
    """

    def __init__(self, physics: MujocoPhysics, objects: Iterable[str]) -> None:
        """Take the names of the objects' bodies; all bodies of the same tree count."""
        self._physics, self._model = physics, physics.model
        model = physics.model
        roots = [model.body_rootid[model.body(name).id] for name in objects]
        bodies = np.isin(model.body_rootid, roots)
        self._rows = {"body": bodies, "dof": bodies[model.dof_bodyid], "geom": bodies[model.geom_bodyid]}
        self._original = {name: getattr(model, name).copy() for name in CHANGED}

    def undo(self) -> None:
        """Restore mass and friction."""
        for name, values in self._original.items():
            getattr(self._model, name)[:] = values

    def dynamics(self) -> DynamicsFactors:
        """Return the present factors, from MuJoCo's model."""
        return DynamicsFactors(self._factor("body_mass"), self._factor("geom_friction"))

    def set_dynamics(self, dynamics: DynamicsFactors) -> None:
        """Scale mass and friction, until the next reset."""
        self.undo()
        for name in MASSES:
            getattr(self._model, name)[self._chosen(name)] *= dynamics.mass
        for name in COMPLIANCES:
            getattr(self._model, name)[self._chosen(name)] /= dynamics.mass
        self._model.geom_friction[:, SLIDING] *= dynamics.friction
        self._physics.settle()

    def _chosen(self, name: str) -> NDArray[np.bool_]:
        """Return the rows of an array of the model that belong to the objects."""
        return self._rows[name.partition("_")[0]]

    def _factor(self, name: str) -> float:
        """Return the ratio of present to original values, in the first row that is not zero."""
        original = self._original[name].reshape(len(self._original[name]), -1)[:, SLIDING]
        row = np.flatnonzero(self._chosen(name) & (original > 0.0))[0]
        return float(np.atleast_1d(getattr(self._model, name)[row])[SLIDING] / original[row])
