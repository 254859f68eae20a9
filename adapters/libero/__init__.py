"""The adapter of LIBERO (robosuite 1.4, MuJoCo). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters.libero.simulation import SIMULATOR

__all__ = ["SIMULATOR"]
