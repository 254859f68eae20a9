"""What the shipped zoo is for."""

WITH_EXPERTS = ("maniskill/", "pybullet/", "robosuite/")
"""Simulators in each of whose tasks an expert was trained and a demonstration recorded."""
