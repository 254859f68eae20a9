"""Simulators of the shipped zoo."""

WITH_EXPERTS = ("maniskill/", "pybullet/", "robosuite/")
"""Simulators in each of whose tasks an expert was trained and a demonstration recorded."""
