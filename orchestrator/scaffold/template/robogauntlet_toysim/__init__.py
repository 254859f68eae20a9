"""Lets RoboGauntlet play the simulator toysim."""
