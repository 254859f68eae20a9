"""Scripted oracle for the null simulator."""

from __future__ import annotations

from collections.abc import Callable

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import OPEN, Script, State, move


class Reach:
    """Moves straight to the goal."""

    def __call__(self, state: State) -> FloatArray:
        """Return one step towards the goal (7,)."""
        return move(state, state["goal_position"], gripper=OPEN, max_step=0.05)


SCRIPTS: dict[str, Callable[[], Script]] = {
    f"null/{task}": Reach for task in ("Reach", "Slow", "Crash", "Hang", "Raise")
}
