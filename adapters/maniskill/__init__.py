"""The adapter of ManiSkill 3 (SAPIEN). Light: the simulator is imported when a task is opened."""

from robogauntlet.adapters.maniskill.simulation import SIMULATOR

__all__ = ["SIMULATOR"]
