"""The adapter of PyBullet through panda-gym. Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters.pybullet.simulation import SIMULATOR

__all__ = ["SIMULATOR"]
