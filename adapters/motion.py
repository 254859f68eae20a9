"""Reads the motion of robot and objects, of which the behaviour in an episode is measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from robogauntlet.adapters.contract import ARM_PREFIXES, GRIPPER, AdapterError, FloatArray, Motion, Moves, Simulation


@runtime_checkable
class MeasuresMotion(Protocol):
    """A `Simulation` that measures contacts and joints too, or is quicker than by its `privileged_state`."""

    def motion(self, entries: Sequence[str]) -> Motion:
        """Return the present motion, with these entries of `privileged_state`. Changes nothing."""


def standing_still(simulation: Simulation) -> FloatArray:
    """Return an action that keeps the arms where they are, with open grippers, of the shape of `action_spec`."""
    spec = simulation.action_spec
    if spec.numbers:
        return simulation.privileged_state()["still"].copy()
    still = np.array([-1.0 if name.endswith(GRIPPER) else 0.0 for name in spec.names])
    if spec.body.moves is Moves.TARGETS:
        state = simulation.privileged_state()
        for number, arm in enumerate(ARM_PREFIXES[: spec.arms]):
            still[spec.joints_of(number)] = state[f"{arm}joint_targets"]
    still[spec.ignored_indices] = 0.0
    return still


def holding(simulation: Simulation, last: FloatArray | None) -> FloatArray:
    """Return an action that keeps the arms where they are, with grippers as the `last` action commanded.

    Targets of joints are those of the last action. Before the first one it is `standing_still`.
    """
    spec = simulation.action_spec
    if last is None or spec.numbers:
        return standing_still(simulation)
    if spec.body.moves is Moves.TARGETS:
        return last.copy()
    return np.where([name.endswith(GRIPPER) for name in spec.names], last, 0.0)


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
