"""Checkpoints for RoboGauntlet, found by `robogauntlet_mergevla.zoo`."""
