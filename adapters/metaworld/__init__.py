"""The adapter of Meta-World (MuJoCo). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters.metaworld.simulation import SIMULATOR

__all__ = ["SIMULATOR"]
