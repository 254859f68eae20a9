"""The adapter of ManiSkill 3 (SAPIEN). Light: the simulator is imported when a task is opened."""

from adapters.maniskill.simulation import SIMULATOR

__all__ = ["SIMULATOR"]
