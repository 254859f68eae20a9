"""Reads the motion of robot and objects, of which the behaviour in an episode is measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from robogauntlet.adapters.contract import Motion, Simulation


@runtime_checkable
class MeasuresMotion(Protocol):
    """A `Simulation` that measures contacts and joints too, or is quicker than by its `privileged_state`."""

    def motion(self, entries: Sequence[str]) -> Motion:
        """Return the present motion, with these entries of `privileged_state`. Changes nothing."""


def motion_of(simulation: Simulation, entries: Sequence[str]) -> Motion:
    """Return the motion of a simulation: by its own `motion`, or else by `privileged_state`.

    Raises:
        KeyError: An entry is missing.
    """
    if isinstance(simulation, MeasuresMotion):
        return simulation.motion(entries)
    state = simulation.privileged_state()
    opening = float(state["finger_positions"].sum())
    return Motion(state["tcp_position"], opening, tuple(state[entry] for entry in entries))
