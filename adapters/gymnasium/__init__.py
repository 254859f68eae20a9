"""The adapter of any gymnasium environment that a mapping file describes. Light: gymnasium is imported on opening."""

from robogauntlet.adapters.gymnasium.simulation import SIMULATOR

__all__ = ["SIMULATOR"]
