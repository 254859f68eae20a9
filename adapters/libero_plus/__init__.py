"""The adapter of LIBERO-Plus (robosuite 1.4, MuJoCo). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters.libero_plus.simulation import SIMULATOR

__all__ = ["SIMULATOR"]
