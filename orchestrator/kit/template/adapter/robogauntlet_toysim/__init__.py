"""Connects the simulator toysim to RoboGauntlet."""
