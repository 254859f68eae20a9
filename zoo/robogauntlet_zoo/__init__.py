"""Checkpoints for RoboGauntlet, found by `robogauntlet.policies.zoo`."""
