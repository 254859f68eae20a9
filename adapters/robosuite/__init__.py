"""The adapter of robosuite (MuJoCo). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters.robosuite.simulation import SIMULATOR

__all__ = ["SIMULATOR"]
