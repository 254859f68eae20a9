"""Reads the motion of robot and objects, of which the behaviour in an episode is measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from robogauntlet.adapters.contract import GRIPPER, AdapterError, FloatArray, Motion, Simulation


@runtime_checkable
class MeasuresMotion(Protocol):
    """A `Simulation` that measures contacts and joints too, or is quicker than by its `privileged_state`."""

    def motion(self, entries: Sequence[str]) -> Motion:
        """Return the present motion, with these entries of `privileged_state`. Changes nothing."""


def standing_still(simulation: Simulation) -> FloatArray:
    """Return an action that keeps the arms where they are, with open grippers, of the shape of `action_spec`."""
    spec = simulation.action_spec
    if spec.joints:
        return np.append(simulation.privileged_state()["joint_targets"], -1.0)
    return np.array([-1.0 if name.endswith(GRIPPER) else 0.0 for name in spec.names])


def motion_reader(simulation: Simulation) -> Callable[[Sequence[str]], Motion]:
    """Return a simulation's own `motion`, or one that reads its `privileged_state`.

    The returned function raises AdapterError for an entry that the state lacks, if it reads the state.
    """
    if isinstance(simulation, MeasuresMotion):
        return simulation.motion

    def by_state(entries: Sequence[str]) -> Motion:
        state = simulation.privileged_state()
        for entry in ("tcp_position", "finger_positions", *entries):
            if entry not in state:
                raise AdapterError(f"expected an entry '{entry}' in privileged_state, which behaviour is measured by")
        opening = float(state["finger_positions"].sum())
        return Motion(state["tcp_position"], opening, tuple(state[entry] for entry in entries))

    return by_state
