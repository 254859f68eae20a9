"""Sets mass and friction of the things in a task."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.adjusting import Dynamics

MASSES = ("body_mass", "body_inertia", "body_subtreemass", "dof_M0")
"""What grows with the mass."""
COMPLIANCES = ("body_invweight0", "dof_invweight0")
"""What falls with it: MuJoCo scales contacts by these, and computes them only when a model is built."""
SLIDING = 0
"""The first of a shape's coefficients of friction."""
CHANGED = (*MASSES, *COMPLIANCES, "geom_friction")


class MujocoBodies:
    """See `adapters.adjusting.Bodies`.

    MuJoCo's contacts take the larger of two frictions: what slides on the table (1) or between the fingertips (2) does
    so no better for a coefficient of its own that is below theirs.
    """

    def __init__(self, model: Any, things: Iterable[str], settle: Callable[[], None]) -> None:
        """Take what can be made heavier.

        Args:
            model: MuJoCo's.
            things: Names of bodies; all that hangs together with them counts.
            settle: Brings forces and contacts up to date.
        """
        self._model, self._settle = model, settle
        roots = [model.body_rootid[model.body(thing).id] for thing in things]
        bodies = np.isin(model.body_rootid, roots)
        self._things = {"body": bodies, "dof": bodies[model.dof_bodyid], "geom": bodies[model.geom_bodyid]}
        self._own = {name: getattr(model, name).copy() for name in CHANGED}

    def undo(self) -> None:
        """Give the things their own mass and friction back."""
        for name, own in self._own.items():
            getattr(self._model, name)[:] = own

    def dynamics(self) -> Dynamics:
        """The factors, from what MuJoCo has now."""
        return Dynamics(self._factor("body_mass"), self._factor("geom_friction"))

    def set_dynamics(self, dynamics: Dynamics) -> None:
        """Give the things other masses and frictions, until the next reset."""
        self.undo()
        for name in MASSES:
            getattr(self._model, name)[self._chosen(name)] *= dynamics.mass
        for name in COMPLIANCES:
            getattr(self._model, name)[self._chosen(name)] /= dynamics.mass
        self._model.geom_friction[self._chosen("geom_friction"), SLIDING] *= dynamics.friction
        self._settle()

    def _chosen(self, name: str) -> NDArray[np.bool_]:
        """Which rows of an array of the model belong to the things."""
        return self._things[name.partition("_")[0]]

    def _factor(self, name: str) -> float:
        """What the model has, against what it came with, in the first of the rows in which there is anything."""
        own = self._own[name].reshape(len(self._own[name]), -1)[:, SLIDING]
        row = np.flatnonzero(self._chosen(name) & (own > 0.0))[0]
        return float(np.atleast_1d(getattr(self._model, name)[row])[SLIDING] / own[row])
